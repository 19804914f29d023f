"""Effects that no column describes, so that their few parameters are searched: those on the scatter, and backlash.

Stray detections, exchanged labels, mistimed frames and noise that grows with speed change what an observation may
be, not where it is expected. Their parameters are searched (:mod:`..hypotheses.simplex_search`), and so are those of
backlash (:mod:`..hypotheses.backlash_search`).
"""

from invdyn.models.effects.base import Effect
from invdyn.models.effects.hidden import HiddenHinge


def is_noise(effect: Effect) -> bool:
    """Whether an effect changes the scatter of what is seen and not its mean."""
    return type(effect).noise is not Effect.noise or is_mistake(type(effect))


def is_mistake(kind: type[Effect]) -> bool:
    """Whether effects of a kind make rows a mixture: of what the tracker may have got wrong."""
    return kind.mistake is not Effect.mistake


def is_searched(effect: Effect) -> bool:
    """Whether the parameters of an effect are searched, because no column describes what they change."""
    return is_noise(effect) or (isinstance(effect, HiddenHinge) and effect.forgets)
