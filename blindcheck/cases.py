"""Cases of the blind check: a recording of a reality, the body file that the diagnosis gets, and the answer.

A case follows from (seed, kind, effect) to the byte, on one machine. Seeds below 10,000 are for development. Those from
1,000,000 on are for blind runs, and have never been looked at.

An effect of usual size that was hardly met (a stop never reached, backlash never crossed; see `visibility`) has
body, motion and sizes drawn again, at most `MAX_DRAWS` times. From the third draw on, each that hardly met an effect
makes it larger by half in the next, five times at most. Backlash seldom shows; what is combined with it keeps its size.
The answer has d′ of every effect.
"""

import json
import pathlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from invdyn.blindcheck.camera import readings
from invdyn.blindcheck.effects import OBSERVATIONS
from invdyn.blindcheck.engine import ENGINES, MUJOCO, Engine
from invdyn.blindcheck.equivalence import stand_ins
from invdyn.blindcheck.injected_effects import Present, drawn, named, pace, shown_by_sensors, world_with
from invdyn.blindcheck.kinds import KINDS
from invdyn.blindcheck.motion import Plan, frame_times, random_plan, simulated
from invdyn.blindcheck.scene import scene
from invdyn.blindcheck.setting import Style, of_robot
from invdyn.blindcheck.visibility import visibility
from invdyn.blindcheck.world import Trajectory
from invdyn.models import Body
from invdyn.recordings import Recording, write_keypoint_csv, write_text

MAX_DRAWS = 16  # of a case
MIN_DPRIME = 30.0  # d′ below which an effect of usual size counts as not met, and all is drawn again
USUAL_DRAWS, GROWTH_PER_DRAW, MAX_GROWTH = 3, 1.5, 1.5**5  # draws of usual size; factor of each later one, and of all
PLACES = tuple(KINDS)  # a kind's number in its seeds
UNLISTED_NEEDS = {"cross_viscosity": ("two joints",), "cable": ("two joints",), "hot_motor": ("command",)}
"""What those outside the catalogue need, as `effects.Injected.needs`."""

NOT_TOGETHER = (  # they write the same number of MuJoCo's, undo each other, or tell time by different clocks
    {"viscous_friction", "drifting_friction"},
    {"coulomb_friction", "stribeck_friction", "load_friction"},
    {"gravity_tilt", "camera_roll"},
    {"actuator_delay", "camera_latency"},
)


@dataclass(frozen=True)
class Case:
    """One case. `other` is a second recording of the same reality, or None; `without` is struck from the catalogue.

    `robot` says that it is a robot's log.
    """

    recording: Recording
    other: Recording | None
    body: Body
    regime: str
    without: tuple[str, ...]
    answer: dict
    robot: bool = False

    def write(self, folder: str | pathlib.Path) -> None:
        """Write all but the answer: recording.csv, perhaps other.csv, body.toml and case.json. Makes the folder."""
        folder = pathlib.Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        write_keypoint_csv(self.recording, folder / "recording.csv")
        if self.other is not None:
            write_keypoint_csv(self.other, folder / "other.csv")
        self.body.to_toml(folder / "body.toml")
        public: dict[str, Any] = {"regime": self.regime, "held_out": "other.csv" if self.other else None}
        public |= {"without": self.without} | ({"robot": True} if self.robot else {})
        write_text(folder / "case.json", json.dumps(public, indent=1) + "\n")


def effects_of(kind: str, engine: str = MUJOCO.name) -> tuple[str, ...]:
    """Names that a case of that kind, simulated by one of `ENGINES`, may have. Raises ValueError for no such kind."""
    if kind not in KINDS:
        raise ValueError(f"expected a kind of case among {', '.join(KINDS)}, got {kind!r}")
    form, player = KINDS[kind], ENGINES[engine]
    if not max(form.numbers):
        return ()

    def may_be(name: str) -> bool:
        asks = needs(name, player)
        shown = not form.robot or name not in OBSERVATIONS or "encoders" in asks
        return shown and name not in form.barred and form.lacks not in asks and _agree((name, *form.everywhere))

    return tuple(filter(may_be, player.unlisted if kind == "outside" else player.effects))


def needs(name: str, engine: Engine = MUJOCO) -> tuple[str, ...]:
    """What a case with an effect must have."""
    return engine.effects[name].needs if name in engine.effects else UNLISTED_NEEDS.get(name, ())


def make_case(seed: int, kind: str, effect: str | Sequence[str] | None = None, engine: str = MUJOCO.name) -> Case:
    """Make one case; `effect` None draws it (several of kinds that have so many); `engine` is one of `ENGINES`.

    Raises ValueError for an unknown kind, or effects that a case of that kind cannot have; ImportError without the
    engine's package.
    """
    known, numbers = effects_of(kind, engine), KINDS[kind].numbers
    rng = np.random.default_rng([seed, PLACES.index(kind)])
    given = (effect,) if isinstance(effect, str) else None if effect is None else tuple(effect)
    if given is not None and (len(given) not in numbers or not set(given) <= set(known) or not _agree(given)):
        several = " or ".join(map(str, numbers))
        raise ValueError(f"a case of kind {kind!r} has {several} of {', '.join(known) or 'no effects'}; got {effect!r}")
    names, number = given, numbers[0] if len(numbers) == 1 else int(rng.choice(numbers))
    while names is None:
        lot = tuple(str(name) for name in rng.choice(known, number, replace=False)) if number else ()
        names = lot if _agree(lot) else None
    best, strength = None, np.full(len(names), KINDS[kind].strength)
    for attempt in range(MAX_DRAWS):
        stream = np.random.default_rng([seed, PLACES.index(kind), *"+".join(names).encode(), attempt])
        case = attempt_case(stream, kind, names, strength, ENGINES[engine])
        if case is None:
            continue
        shown = np.array([each["dprime"] for each in case.answer["effects"]])
        if attempt + 1 >= USUAL_DRAWS:
            strength = np.where(shown < MIN_DPRIME, np.minimum(strength * GROWTH_PER_DRAW, MAX_GROWTH), strength)
        met = float(shown.min(initial=np.inf))
        if best is None or met > best[0]:
            best = met, case
        if kind == "weak" or met >= MIN_DPRIME or (kind == "unknown_torque" and not set(names) & set(OBSERVATIONS)):
            break
    if best is None:
        raise RuntimeError(f"case {seed} of kind {kind!r} ({names}) spun, diverged or had no mass in {MAX_DRAWS} tries")
    best[1].answer.update(seed=seed, engine=engine)
    return best[1]


def _agree(names: Sequence[str]) -> bool:
    return len(set(names)) == len(names) and all(len(group & set(names)) < 2 for group in NOT_TOGETHER)


def attempt_case(
    rng: np.random.Generator, kind: str, names: Sequence[str], strength: np.ndarray, engine: Engine
) -> Case | None:
    """One draw of body, motion and sizes, or None where it cannot be a case."""
    form, setting = KINDS[kind], engine.setting
    regime = next(iter(form.regimes))
    if len(form.regimes) > 1:
        regime = str(rng.choice(list(form.regimes), p=list(form.regimes.values())))
    passive = regime == "passive"
    wanted = [*form.needs, *(need for name in names for need in needs(name, engine))]
    true_body, body = setting.bodies(rng, wanted, (*names, *form.everywhere), passive)
    plan = random_plan(rng, true_body, passive, engine.world, setting.habits)
    plain = simulated(engine.world(true_body), engine.world(body), plan)
    if _wild(plain):
        return None
    yardsticks = scene(true_body, plan, plain, engine.world)
    odd = [drawn(rng, name, yardsticks, much, engine) for name, much in zip(names, strength, strict=True)]
    joints = range(body.num_joints)
    usual = [drawn(rng, name, yardsticks, much, engine, k) for name, much in form.everywhere.items() for k in joints]
    present = [*odd, *usual]
    seed = tuple(int(word) for word in rng.integers(2**31, size=4))
    noise = float(np.clip(yardsticks.reach * np.exp(rng.uniform(np.log(1e-3), np.log(7e-3))), 1e-4, 5e-3))
    noise = float(f"{noise:.3g}")
    style = of_robot(rng) if form.robot else setting.style(rng, names)
    nominal = engine.world(body)
    world = world_with(true_body, present, yardsticks, engine)
    if not world.possible:
        return None
    real = simulated(world, nominal, plan, pace(present))
    if _wild(real) or ("joint_coupling" in names and not _unambiguous(real)):
        return None
    answer: dict[str, Any] = {
        "kind": kind,
        "regime": regime,
        "effects": [
            named(each, body, engine) | visibility(each, present, yardsticks, real, regime, noise, seed, engine, style)
            for each in odd
        ],
        **({"everywhere": [named(each, body, engine) for each in usual]} if usual else {}),
        "body": setting.described(true_body),
        "joints": list(body.joint_names),
        "links": [link.name for link in body.links],
        "noise": {"keypoint_sd": noise, "encoder_sd": style.encoder, "law": engine.noise_law(seed)},
    }
    other = None
    if kind != "none" and rng.random() < 0.3 and "external_push" not in names:
        again = replace(
            random_plan(rng, true_body, passive, engine.world, setting.habits),
            frame_rate=plan.frame_rate,
            command_rate=plan.command_rate,
        )
        second = simulated(world_with(true_body, present, yardsticks, engine), nominal, again, pace(present))
        if not _wild(second):
            other = _record(second, again, body, regime, present, noise, (*seed, 1), style, "other", engine)
    recording = _record(real, plan, body, regime, present, noise, seed, style, "recording", engine)
    struck: tuple[str, ...] = ()
    if kind == "leave_one_out":
        struck = (*names, *(other for each in answer["effects"] for other in stand_ins(each, answer)))
    return Case(recording, other, body, regime, struck, answer, form.robot)


def _wild(trajectory: Trajectory) -> bool:
    return not np.isfinite(trajectory.q).all() or bool((np.ptp(trajectory.q, axis=0) > 2 * np.pi).any())


def _unambiguous(trajectory: Trajectory) -> bool:
    """Whether the first row's angles lie within half a turn of 0: pictures do not tell whole turns, a coupling does."""
    first = int(np.argmin(np.abs(trajectory.time)))
    return bool((np.abs(trajectory.q[first]) < np.pi).all())


def _record(
    real: Trajectory,
    plan: Plan,
    body: Body,
    regime: str,
    present: Sequence[Present],
    noise: float,
    seed: Sequence[int],
    style: Style,
    name: str,
    engine: Engine,
) -> Recording:
    """The table that the diagnosis gets: stated times, what the camera and encoders gave, perhaps commands."""
    stated = frame_times(plan)
    when = stated / pace(present)
    rng = np.random.default_rng([*seed, 0])
    points = engine.film(real, when, shown_by_sensors(present), noise, seed)
    points = np.round(points if style.base else points[:, 1:], 7)
    angles = None
    if style.encoder:
        true = readings(real, when, shown_by_sensors(present))
        angles = np.round(true + style.encoder * rng.standard_normal(true.shape), 7)
    missing = rng.random(len(stated)) < style.missing
    missing[0] = False
    points[missing] = np.nan
    names = (body.joint_names[0], *body.keypoint_names) if style.base and body.is_chain else body.keypoint_names
    if not style.filmed:
        points, names = points[:, :0], ()
    joints = body.joint_names if regime == "commanded" or angles is not None else ()
    if regime != "commanded":
        return Recording(stated, points, names, angles=angles, joint_names=joints, name=name)
    each = round(plan.command_rate / plan.frame_rate)
    rows = np.arange((len(stated) - 1) * each + 1)
    first = int(np.argmin(np.abs(real.command_time)))

    def at_all_rows(values: np.ndarray) -> np.ndarray:
        full = np.full((len(rows), *values.shape[1:]), np.nan)
        full[::each] = values
        return full

    return Recording(
        rows / plan.command_rate,
        at_all_rows(points),
        names,
        angles=None if angles is None else at_all_rows(angles),
        torques=np.vectorize(lambda u: float(f"{u:.8g}"))(real.command[first + rows]),
        joint_names=joints,
        name=name,
    )


def planned(
    kind_counts: Mapping[str, int], seed: int, engine: str = MUJOCO.name
) -> list[tuple[str, int, str, str | None]]:
    """(name, seed, kind, effect) of so many cases of each kind; arguments of `make_case` but for the name.

    Effects take turns in a random order, so that each is met as often as the others. Names are numbers in an order
    drawn over all kinds: they tell nothing. Raises ValueError for an unknown kind.
    """
    plan: list[tuple[int, str, str | None]] = []
    for kind, count in kind_counts.items():
        known = effects_of(kind, engine)
        rng = np.random.default_rng([seed, PLACES.index(kind), 7])
        turns: list[str] = []
        for number in range(count):
            if not turns:
                turns = [str(name) for name in rng.permutation(known)]
            plan.append((seed + number, kind, turns.pop() if KINDS[kind].numbers == (1,) else None))
    places = np.random.default_rng([seed, 11]).permutation(len(plan))
    return [(f"case-{place:04d}", *each) for place, each in sorted(zip(places.tolist(), plan, strict=True))]
