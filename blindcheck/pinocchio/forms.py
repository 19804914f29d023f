"""The second generator's forms of effects: `MECHANISMS` by name, and the draws of what they have besides.

Names, places, units and typical sizes are those of :mod:`invdyn.blindcheck.effects`, which speak the catalogue's
language. A form draws more parameters besides, or others: those that have no units there go into the answer's `form`.
"""

from collections.abc import Callable

import numpy as np

from invdyn.blindcheck.effects import EFFECTS
from invdyn.blindcheck.scene import Scene

Draw = Callable[[np.random.Generator, Scene, int, dict], dict]
"""(generator, scene, place, parameters of usual size) → parameters of the form."""

MECHANISMS: dict[str, Callable[..., None]] = {}
"""What installs each effect of the dynamics: (world, place unless of the whole arm, parameters by name)."""
DRAWS: dict[str, Draw] = {}
"""Forms' draws, of effects that have any."""


def form(draw: Draw | None = None) -> Callable:
    """Decorate the function that installs an effect of the dynamics; its name is the effect's."""

    def tell(install: Callable[..., None]) -> Callable[..., None]:
        name = install.__name__
        MECHANISMS[name] = install
        if draw is not None:
            DRAWS[name] = draw
        return install

    return tell


def drawn_form(name: str, rng: np.random.Generator, s: Scene, place: int, strength: float) -> dict:
    """Parameters of an effect in one of its forms here."""
    usual = {key: float(value) for key, value in EFFECTS[name].size(rng, s, place, strength).items()}
    return DRAWS[name](rng, s, place, usual) if name in DRAWS else usual


def hard_or_creeping(rng: np.random.Generator, s: Scene, k: int, p: dict) -> dict:
    """Half of all dry frictions are hard, half are smoothed over .4 to 3 % of the joint's usual speed."""
    return p if rng.random() < 0.5 else p | {"creep": float(rng.uniform(0.004, 0.03) * s.speed[k])}


def _lens(rng: np.random.Generator, s: Scene, place: int, p: dict) -> dict:
    return p if rng.random() < 0.5 else {key: v for key, v in p.items() if key != "k1"} | {"division": p["k1"]}


def _outliers(rng: np.random.Generator, s: Scene, place: int, p: dict) -> dict:
    p = p | {"in_a_row": float(rng.integers(1, 4))}
    return p if rng.random() < 0.5 else {key: v for key, v in p.items() if key != "scale"} | {"within": 1.2 * s.reach}


def _limit(rng: np.random.Generator, s: Scene, k: int, p: dict) -> dict:
    if rng.random() < 0.5:
        return p
    del p["damping"]
    return p | {"loss": float(rng.uniform(0.05, 0.4) / s.speed[k])}


DRAWS.update(
    joint_limit=_limit,
    actuator_deadzone=lambda rng, s, k, p: p if rng.random() < 0.5 else p | {"soft": 1.0},
    soft_tissue=lambda rng, s, k, p: {"kappa": p["kappa"], "damping_ratio": float(rng.uniform(0.7, 1.5))},
    lens_distortion=_lens,
    timestamp_jitter=lambda rng, s, place, p: p if rng.random() < 0.5 else p | {"uniform": 1.0},
    outliers=_outliers,
    label_swap=lambda rng, s, place, p: p | {"in_a_row": float(rng.integers(1, 5))},
    varying_noise=lambda rng, s, place, p: {"slope_in_squares": p["slope"]},
)
