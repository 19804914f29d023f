"""What is known of the torques in a recording: it decides what a residual torque stands for, and what can show.

    commanded        torques known: the residual is what the simulation lacks
    passive          torques known to be zero: the same, and no motor
    unknown_torque   the residual is the limb's own torque, of any size; only what it cannot imitate shows

Sizes of the residual are in typical torques. The *spike*, far too small to matter, says "this cause explains all there
is". The *slab*, sizes at equal ratios up to a typical torque, says "something is left that the
residual must imitate" (Mitchell & Beauchamp 1988, JASA 83). Each has half of the prior. A limb's own torque has no
spike.
"""

from dataclasses import dataclass, replace

import numpy as np

from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.models.effects.base import Effect, stages_of


@dataclass(frozen=True)
class Regime:
    """One of the three.

    Attributes:
        name: as it stands in diagnosis.json.
        phrase: in the report.
        knows_torque: whether torques are known, so that any residual is a gap.
        commanded: whether commands to motors are known.
        decay: of the residual torque, 1/s. Friction and the like change several times in a swing, a limb's own torque
            with it.
        path_size: size of the residual under which the data's own path is found; a limb's own torque is larger.
        dynamics_noise: the dynamics' own noise, in that of inference. What that noise can follow is no gap, and
            backlash or bending is so small. A limb's own torque follows more than that.
        levels: (G,) sizes of the residual that are possible.
    """

    name: str
    phrase: str
    knows_torque: bool
    commanded: bool
    decay: float
    path_size: float
    dynamics_noise: float
    levels: tuple[float, ...]

    @property
    def sizes(self) -> np.ndarray:
        """(G,) ``levels``."""
        return np.array(self.levels)

    @property
    def log_prior(self) -> np.ndarray:
        """(G,) log prior of each size."""
        return self.log_prior_of_first(len(self.levels))

    def log_prior_of_first(self, count: int) -> np.ndarray:
        """The same if only the first ``count`` sizes were possible: half for the spike, where there is one."""
        spike = [0.5] * self.knows_torque
        others = count - len(spike)
        return np.log([*spike, *np.full(others, (1 - sum(spike)) / others)])

    def hides(self, effect: Effect) -> bool:
        """Whether the residual may do what an effect does without being a gap."""
        return not self.knows_torque and imitable(effect)


def regimes(rules: Rules = DEFAULT) -> dict[str, Regime]:
    """The three, by name."""
    own, seen = rules.residual, (rules.residual.spike_size, *rules.residual.slab_sizes)
    known = Regime(
        "commanded",
        "commanded torques known",
        True,
        True,
        own.residual_decay,
        own.data_path_size,
        own.dynamics_noise,
        seen,
    )
    passive = replace(known, name="passive", phrase="no torque at the joints", commanded=False)
    limb = (own.limb_decay, own.limb_path_size, 1.0, own.limb_sizes)
    return {
        each.name: each for each in (known, passive, Regime("unknown_torque", "torques unknown", False, False, *limb))
    }


REGIMES = regimes(DEFAULT)
"""By name, under the usual rules."""
COMMANDED, PASSIVE, UNKNOWN_TORQUE = REGIMES.values()


def regime_of(torques: np.ndarray | None, passive: bool, rules: Rules = DEFAULT) -> Regime:
    """That of a recording with these torques, (T, K) or none at all, NaN where missing."""
    known = torques is not None and np.isfinite(torques).any()
    return regimes(rules)["passive" if passive else "commanded" if known else "unknown_torque"]


def imitable(effect: Effect) -> bool:
    """Whether an unknown torque could do what an effect does: one that changes motion or time, and not what is seen."""
    stages = set(stages_of(effect))
    shown = effect.sensor == "encoders" or stages & {"points", "noise", "outlier", "mistiming"}
    return not shown and (not effect.sensor or bool(stages))
