"""Effects that no column describes, so that their few parameters are searched: those on the scatter, and backlash.

Outliers, exchanged labels, mistimed frames and noise that grows with speed change the distribution of an observation,
not its mean. Their parameters are searched (:mod:`..hypotheses.simplex_search`), and so are those of a gap between two
contacts (:mod:`..hypotheses.backlash_search`).
"""

from invdyn.models.effects.base import Effect, stages_of
from invdyn.models.effects.hidden import HiddenHinge


def is_outlier(effect: Effect) -> bool:
    """Whether an effect shows a keypoint where something else is; not looked for where no detection is an outlier."""
    return "outlier" in stages_of(effect)


def is_mistake(effect: Effect) -> bool:
    """Whether an effect makes rows a mixture: of what the tracker may have got wrong."""
    return is_outlier(effect) or "mistiming" in stages_of(effect)


def is_noise(effect: Effect) -> bool:
    """Whether an effect changes the scatter of what is seen and not its mean."""
    return is_mistake(effect) or "noise" in stages_of(effect)


def is_searched(effect: Effect) -> bool:
    """Whether the parameters of an effect are searched, because no column describes what they change."""
    return is_noise(effect) or (isinstance(effect, HiddenHinge) and effect.forgets)
