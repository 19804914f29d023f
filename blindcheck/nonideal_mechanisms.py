"""Non-ideal mechanisms: friction through bristles, tissue that oscillates by itself.

    bristles   −(σ₀ z + σ₁ ż),  ż = θ̇ − σ₀ |θ̇| z / g(θ̇),  g = τc + (τs − τc) exp(−(θ̇/ωs)²)
    tissue     δ̈ + 2ζω δ̇ + ω² δ = −p̈,  ω = 1/√κ:  −κ p̈ where motion is slow

The first is LuGre: Canudas de Wit, Olsson, Åström & Lischinsky, IEEE TAC 40 (1995), p. 419. N steps; SI units, radians.
"""

from typing import Any

import numpy as np
from scipy.signal import cont2discrete, lfilter, lfilter_zi

from invdyn.blindcheck.simulator import World


def bristles(
    world: World, joint: int, coulomb: float, static: float, velocity: float, stiffness: float, damping: float
) -> None:
    """Dry friction through bristles of stiffness σ₀, N·m/rad, and damping σ₁, N·m·s/rad, unbent to begin with."""
    bent = {"z": 0.0, "at": np.inf}

    def act(t: float, model: Any, data: Any) -> None:
        h, step = world.hinge(joint), model.opt.timestep
        z = 0.0 if t <= bent["at"] else bent["z"]
        speed = data.qvel[h] + step / 2 * data.qacc[h]
        level = coulomb + (static - coulomb) * np.exp(-((speed / velocity) ** 2))
        # exact over a step of constant speed, so that bristles as stiff as steps are short stay bent as they should
        rate = stiffness * abs(speed) / level
        after = z + (speed - rate * z) * step * (-np.expm1(-rate * step) / (rate * step) if rate else 1.0)
        data.qfrc_applied[h] -= stiffness * (z + after) / 2 + damping * (after - z) / step
        bent.update(z=after, at=t)

    world.on_step(act)


def swung(time: np.ndarray, acceleration: np.ndarray, kappa: float, damping_ratio: float) -> np.ndarray:
    """δ (N+1, 2), m, of tissue on a point of so much acceleration (N+1, 2), m/s², on an even grid; steady at first."""
    swing = [-kappa], [kappa, 2 * damping_ratio * kappa**0.5, 1.0]
    above, below, _ = cont2discrete(swing, time[1] - time[0], "foh")
    state = np.outer(lfilter_zi(above[0], below), acceleration[0])
    return lfilter(above[0], below, acceleration, axis=0, zi=state)[0]
