"""What motors make of a command: MuJoCo's gear, filter and force range, or the command changed on its way.

backlash     a rotor of its own inertia (taken from the link's, so that with a gap of zero nothing changes) and a second
hinge with stops ±width/2
"""

from collections import deque
from typing import Any

import numpy as np

from invdyn.blindcheck.effects.effect import mechanism, set_motor
from invdyn.blindcheck.motion import between
from invdyn.blindcheck.scene import Scene, natural_hz, sign
from invdyn.blindcheck.simulator import World, set_part

ROTOR_SHARE = 0.5  # of a link's inertia about its centre of mass, when there is backlash between motor and link


@mechanism(
    units={"gain": "1"}, needs=("command",), size=lambda rng, s, k, a: {"gain": a * sign(rng) * rng.uniform(0.1, 0.25)}
)
def actuator_gain(world: World, joint: int, gain: float) -> None:
    """(1 + ε) u."""
    set_motor(world, joint, gear=[1 + gain, 0, 0, 0, 0, 0])


@mechanism(
    units={"delay": "s"},
    needs=("command",),
    size=lambda rng, s, k, a: {"delay": a * np.clip(rng.uniform(0.01, 0.05) / natural_hz(s), 0.005, 0.05)},
)
def actuator_delay(world: World, joint: int, delay: float) -> None:
    """u(t − T), of the last commands by interpolation; before the first, the first.

    Of delay/interval = n + f, (1 − f) u[c − n] + f u[c − n − 1]: the interval is the engine's, a step's or a row's.
    """
    late: deque[float] = deque()

    def of(u: float, interval: float, first: bool) -> float:
        if first:
            late.clear()
        late.append(u)
        whole, part = divmod(delay / interval, 1.0)
        while len(late) > whole + 2:
            late.popleft()
        newer, older = (late[max(len(late) - 1 - int(whole) - back, 0)] for back in (0, 1))
        return (1 - part) * newer + part * older

    world.drive(joint, of)


@mechanism(
    units={"time_constant": "s"},
    needs=("command",),
    size=lambda rng, s, k, a: {"time_constant": a * np.clip(rng.uniform(0.01, 0.05) / natural_hz(s), 0.005, 0.05)},
)
def actuator_lag(world: World, joint: int, time_constant: float) -> None:
    """T u̇_f + u_f = u."""

    def change(spec: Any) -> None:
        motor = spec.actuator(world.pieces[world.hinge(joint)].hinge)
        # not mjDYN_FILTEREXACT, whose decay over a step is exact without Runge–Kutta: with it, it decays twice, as a
        # time constant longer by half a step
        motor.dyntype = world.mujoco.mjtDyn.mjDYN_FILTER
        set_part(motor, {"dynprm": time_constant})

    world.on_spec(change)


def _actuator_saturation(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict:
    u = np.abs(s.motion.command[:, k])
    return {"limit": s.peak[k] - a * (s.peak[k] - np.quantile(u, rng.uniform(0.6, 0.85)))}


@mechanism(units={"limit": "N·m"}, needs=("command",), size=_actuator_saturation)
def actuator_saturation(world: World, joint: int, limit: float) -> None:
    """Of the command u, clip(u, ±u_max)."""
    set_motor(world, joint, forcerange=[-limit, limit], forcelimited=True)


@mechanism(
    units={"width": "N·m"},
    needs=("command",),
    size=lambda rng, s, k, a: {"width": a * rng.uniform(0.02, 0.06) * s.peak[k]},
)
def actuator_deadzone(world: World, joint: int, width: float, soft: float = 0.0) -> None:
    """Of the command u, u − clip(u, ±d); or softly so, u − d tanh(u/d)."""
    inner = (lambda u: width * np.tanh(u / width)) if soft else (lambda u: min(max(u, -width), width))
    world.drive(joint, lambda u, interval, first: u - inner(u))


@mechanism(
    units={"width": "rad"},
    needs=("command",),
    size=lambda rng, s, k, a: {"width": a * np.deg2rad(between(rng, 0.5, 2.0))},
)
def backlash(world: World, joint: int, width: float) -> None:
    """Backlash of this total width between the motor, with a rotor's inertia, and the link."""
    link = world.add_rotor(joint, ROTOR_SHARE)
    limits = {"limited": True, "range": [-width / 2, width / 2]}
    world.on_spec(lambda spec: set_part(spec.joint(link.hinge), limits))
