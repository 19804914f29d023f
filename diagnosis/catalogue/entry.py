"""What a diagnosis knows of an effect besides its physics (:mod:`invdyn.models.effects`): words, relatives, limits."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from torch import Tensor

from invdyn.models.bodies.planar import BodyParameters
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.base import Effect, Scale, Values, as_variant, effect_name, stages_of

Numbers = Mapping[str, float]
"""An effect's parameters by their own names."""
Names = Mapping[str, str]

Reported = Callable[[Effect, Values], dict[str, tuple[Tensor, str]]]
Credible = Callable[[Effect, Numbers, Numbers, Scale], bool]
Starts = Callable[[Effect, Effect, Numbers, Scale], Sequence[Numbers]]
Together = Callable[[Sequence[tuple[Effect, Numbers]], Scale], bool]
SamePeriod = Callable[[float, BodyParameters], Numbers | None]


def credible_always(effect: Effect, mean: Numbers, sd: Numbers, scale: Scale) -> bool:
    """Of an effect whose parameters mean the same at all values."""
    return True


def as_parameters(effect: Effect, values: Values) -> dict[str, tuple[Tensor, str]]:
    """Nothing but the parameters themselves is reported."""
    return {}


@dataclass(frozen=True)
class Variant:
    """A non-ideal variant of an effect, and the values from which its search starts.

    Attributes:
        words: by a parameter that only the variant has, what it is.
        values: of parameters that the ideal law does not have.
        factors: on values of the ideal law.
        without: parameters of the previous variant that it does not have.
        of: makes it of an effect that is one idealisation more ideal; None where that has no such variant.
    """

    words: Names
    values: Numbers = field(default_factory=dict)
    factors: Numbers = field(default_factory=dict)
    without: tuple[str, ...] = ()
    of: Callable[[Effect], Effect | None] = as_variant

    def start(self, ideal: Numbers) -> dict[str, float]:
        """Values near the ``ideal`` law's, or the previous variant's."""
        kept = {name: value * self.factors.get(name, 1) for name, value in ideal.items() if name not in self.without}
        return kept | dict(self.values)


@dataclass(frozen=True)
class CatalogueEntry:
    """An effect of a catalogue; only the effect has to be given.

    Attributes:
        effect: its class.
        phrase: its name in a sentence, such as "viscous friction".
        meaning: what it is, in half a sentence.
        shown_by: the recording that shows it and nothing like it.
        forms: what its other readings are, by :attr:`.Effect.forms`.
        variants: non-ideal ones, each without one idealisation more than the one before (:meth:`Catalogue.nonideal`).
        needs: what a recording must have to show it, by form, "" for none: "torque" that is commanded, "command" of
            a torque or a servo's target, or the tracker's "confidence".
        per_recording: whether its parameters are those of one recording, as of a push; others need not confirm it.
        outliers: whether heavy tails of the noise may say the same.
        twins: effects that are the same in every recording: its parameters, by name, and theirs of the same value.
        special_cases: effects that it contains: these of its parameters, by name, at the values of theirs.
        starts: by name, effects of which this one may be an imitation, and values from which to search them.
        same_period: the parameters with which it changes a pendulum's period by a factor (:mod:`.period_equivalents`).
        credible: whether values, with these standard deviations, mean what the effect's name says.
        credible_together: the same of all its instances in a cause.
        reported: name → (value, unit), where it is not the parameters themselves.
        limits: of what is reported, the size at which it is cut, and what one as large as that means.
        body_file_fields: parameters that add to a number of the joint (:class:`.JointParts`) in the simulation's file.
        file_change: what a corrected file changes (:mod:`..write_back.changes`); "" for what no file can say.
        said_in_part: which part of it a file says, if not all.
        preposition: before its place, in a sentence.
    """

    effect: type[Effect]
    phrase: str = ""
    meaning: str = ""
    shown_by: str = ""
    forms: Names = field(default_factory=dict)
    variants: tuple[Variant, ...] = ()
    needs: Names = field(default_factory=dict)
    per_recording: bool = False
    outliers: bool = False
    twins: Mapping[str, Names] = field(default_factory=dict)
    special_cases: Mapping[str, Names] = field(default_factory=dict)
    starts: Mapping[str, Starts] = field(default_factory=dict)
    same_period: SamePeriod | None = None
    credible: Credible = credible_always
    credible_together: Together | None = None
    reported: Reported = as_parameters
    limits: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    body_file_fields: Names = field(default_factory=dict)
    file_change: str = ""
    said_in_part: str = ""
    preposition: str = ""

    @property
    def words(self) -> str:
        """Its name in a sentence."""
        return self.phrase or effect_name(self.effect).replace("_", " ")

    @property
    def variant_words(self) -> dict[str, str]:
        """What its variants are, by a parameter that only they have."""
        return {name: text for variant in self.variants for name, text in variant.words.items()}

    def need_of(self, effect: Effect) -> str:
        """What a recording must have to show an instance; of one that changes a command, a commanded torque."""
        commanded = not effect.sensor and "command" in stages_of(effect)
        return self.needs.get(effect.form or "", "torque" if commanded else "")

    def of_motors(self, effect: Effect) -> bool:
        """Whether an instance acts on a command, and shows in nothing else."""
        return not effect.sensor and self.need_of(effect) in ("torque", "command")

    def start(self, variant: Effect, ideal: Numbers) -> dict[str, float]:
        """Values from which a non-ideal ``variant`` is searched, near those of the law that is one less so."""
        found = self.variants[variant.variant - 1 : variant.variant] or (Variant({}),)
        return found[0].start(ideal)


class Catalogue(Mapping[str, CatalogueEntry]):
    """Effects by name; ``CATALOGUE | {"belt": BeltDrag}`` is another one, with an effect of one's own.

    Args:
        entries: name → entry, or class of an effect, whose entry has no words and relatives.

    Raises TypeError for what is neither.
    """

    def __init__(self, entries: Mapping[str, Any]):
        self._entries = {name: _entry(name, given) for name, given in entries.items()}

    def __getitem__(self, name: str) -> CatalogueEntry:
        return self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __hash__(self) -> int:
        return hash(tuple(self._entries))

    def separating_experiment(self, effects: Sequence[str]) -> str | None:
        """The recordings that show rivals, the most probable one's first, in a sentence; None for fewer than two."""
        known = (self[name].shown_by for name in effects if name in self)
        wanted = list(filter(None, dict.fromkeys(known)))
        return f"Record {'; and '.join(wanted)}." if len(effects) > 1 and wanted else None

    def __or__(self, other: Mapping[str, Any]) -> "Catalogue":
        return Catalogue({**self, **other})

    def everywhere(self, body: ArticulatedBody, keypoints: Sequence[str]) -> Iterator[tuple[CatalogueEntry, Effect]]:
        """Every effect at every place of ``body``, bound and called as in this catalogue; ``keypoints`` are tracked."""
        for name, entry in self.items():
            for effect in entry.effect.everywhere(body, keypoints):
                effect.name = name
                yield entry, effect.bound(body)

    def without(self, names: Sequence[str]) -> "Catalogue":
        """All entries but some, by name."""
        return Catalogue({name: entry for name, entry in self.items() if name not in names})

    def of(self, effect: Effect) -> CatalogueEntry:
        """An effect's entry; a bare one where the catalogue does not have the effect."""
        return self._entries.get(effect.name) or CatalogueEntry(type(effect))

    def nonideal(self, effect: Effect) -> Effect | None:
        """The same effect at the same place, without one idealisation more; None if there is none."""
        found = self.of(effect).variants[effect.variant : effect.variant + 1]
        return found[0].of(effect) if found else None


def _entry(name: str, given: Any) -> CatalogueEntry:
    if isinstance(given, CatalogueEntry):
        return given
    if isinstance(given, type) and issubclass(given, Effect):
        return CatalogueEntry(given)
    raise TypeError(f"{name}: expected an effect's class or a CatalogueEntry, got {given!r}")
