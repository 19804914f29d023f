"""What is known of the torques in a recording: it decides what a residual torque stands for, and what can show.

    commanded        torques known: the residual is what the simulation lacks
    passive          torques known to be zero: the same, and no motor
    unknown_torque   the residual is the limb's own torque, of any size; only what it cannot imitate shows

Sizes of the residual are in typical torques. The *spike*, far too small to matter, says "this cause explains all there
is". The *slab*, sizes spread evenly over the powers of ten up to a typical torque, says "something is left that the
residual must imitate" (Mitchell & Beauchamp 1988, JASA 83). Each has half of the prior. A limb's own torque has no
spike.
"""

from dataclasses import dataclass, replace

import numpy as np

from invdyn.models.effects.base import Effect

SPIKE = 1e-4
SLAB = tuple(np.geomspace(2e-3, 1.0, 6))
LIMB = tuple(np.geomspace(0.03, 30.0, 15))
"""Sizes of a limb's own torque, which in fast motions is far above what holds the limb up."""
FIRM = 1e-3
"""Smallest size under which a path is sought: stiffer chains would only take more steps."""


@dataclass(frozen=True)
class Regime:
    """One of the three.

    Attributes:
        name: as it stands in diagnosis.json.
        phrase: in the report.
        knows_torque: whether torques are known, so that any residual is a gap.
        commanded: whether motors were told something.
        decay: of the residual torque, 1/s. Friction and the like change several times in a swing, a limb's own torque
            with it.
        loose: size of the residual under which the data's own path is found; a limb's own torque is larger.
        firmer: the dynamics' own noise, in that of inference. Where torques are known, what that noise can follow is no
            gap, and play or bending is so small. A limb's own torque follows more than that.
        levels: (G,) sizes of the residual that are possible.
    """

    name: str
    phrase: str
    knows_torque: bool
    commanded: bool
    decay: float
    loose: float
    firmer: float
    levels: tuple[float, ...]

    @property
    def sizes(self) -> np.ndarray:
        """(G,) ``levels``."""
        return np.array(self.levels)

    @property
    def log_prior(self) -> np.ndarray:
        """(G,) log prior of each size."""
        return log_prior(self.sizes)

    def hides(self, effect: Effect) -> bool:
        """Whether the residual may do what an effect does without being a gap."""
        return not self.knows_torque and imitable(effect)


COMMANDED = Regime("commanded", "commanded torques known", True, True, 20.0, 0.3, 0.3, (SPIKE, *SLAB))
PASSIVE = replace(COMMANDED, name="passive", phrase="no torque at the joints", commanded=False)
UNKNOWN_TORQUE = Regime("unknown_torque", "torques unknown", False, False, 4.0, 3.0, 1.0, LIMB)
REGIMES = {regime.name: regime for regime in (COMMANDED, PASSIVE, UNKNOWN_TORQUE)}
"""By name."""


def regime_of(torques: np.ndarray | None, passive: bool) -> Regime:
    """That of a recording with these torques, (T, K) or none at all, NaN where missing."""
    if passive:
        return PASSIVE
    return COMMANDED if torques is not None and np.isfinite(torques).any() else UNKNOWN_TORQUE


def log_prior(levels: np.ndarray) -> np.ndarray:
    """(G,) log prior of sizes of the residual: half for the spike, where there is one."""
    if levels[0] == SPIKE:
        return np.log(np.r_[0.5, np.full(len(levels) - 1, 0.5 / (len(levels) - 1))])
    return np.full(len(levels), -np.log(len(levels)))


def imitable(effect: Effect) -> bool:
    """Whether an unknown torque could do what an effect does."""
    seen = type(effect).points is not Effect.points  # a base that shakes takes all points along
    return (effect.side == "dynamics" and not seen) or effect.name in ("clock_rate", "camera_latency")
