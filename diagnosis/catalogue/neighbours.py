"""Neighbours of an effect: what a search may put in its place, and the values from which it starts.

    twin        the same in every recording, from its own parameters' values (``CatalogueEntry.twins``); of one link
                that hangs freely, all that change its period (``CatalogueEntry.same_period``)
    wider       an effect that contains it (``CatalogueEntry.special_cases``), from where the two are the same
    narrower    its special case, where its own parameters allow that, from those known best
    similar     an effect that it may imitate (``CatalogueEntry.starts``), from several values

Its non-ideal variants are the same effect (:meth:`.Catalogue.nonideal`).
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from invdyn.diagnosis.catalogue.entry import Catalogue
from invdyn.diagnosis.catalogue.period_equivalents import factor
from invdyn.diagnosis.rules import FIXED
from invdyn.models.bodies.planar import BodyParameters
from invdyn.models.effects.base import Effect, Scale

Kind = Literal["twin", "wider", "narrower", "similar"]


@dataclass(frozen=True)
class Neighbour:
    """An effect in the place of another.

    Attributes:
        effect: bound.
        kind: of neighbour; see the top of the file.
        starts: values of its parameters, by their own names, from which to search; those left out have defaults.
    """

    effect: Effect
    kind: Kind
    starts: Sequence[Mapping[str, float]]


def neighbours(
    mine: Effect,
    values: Mapping[str, float],
    sd: Mapping[str, float],
    candidates: Sequence[Effect],
    scale: Scale,
    passive: bool,
    catalogue: Catalogue,
) -> Iterator[Neighbour]:
    """Neighbours among the ``candidates``, all bound, of an effect with these values and their standard deviations.

    By the parameters' own names; ``passive`` if no motor acts.
    """
    entry, one = catalogue.of(mine), len(scale.torque) == 1
    # in space an effect may have other parameters, and then no twin
    twins: dict[str, Mapping[str, float]] = {
        other: {its: values[own] for own, its in same.items()}
        for other, same in entry.twins.items()
        if same.keys() <= values.keys()
    }
    if one and passive and entry.same_period is not None:
        twins |= of_same_period(mine, values, scale, catalogue)

    def whole(effect: Effect) -> bool:
        """Whether it is that of the whole arm."""
        return one or not effect.where

    for other in candidates:
        here = other.where == mine.where
        if other.name in twins and other.form is None and other.key != mine.key and whole(mine) and whole(other):
            yield Neighbour(other, "twin", [twins[other.name]])
        if here and (names := catalogue.of(other).special_cases.get(mine.name)):
            yield Neighbour(other, "wider", [{name: values[its] for name, its in names.items()}])
        if here and (names := entry.special_cases.get(other.name)):
            worst_first = sorted(names, key=lambda name: -sd[name])
            same = {names[name]: values[name] for name in worst_first}
            if all(abs(values[name] - same[its]) <= FIXED.special_case_sds * sd[name] for name, its in names.items()):
                yield Neighbour(other, "narrower", [same])
        if (start := entry.starts.get(other.name)) and (starts := start(mine, other, values, scale)):
            yield Neighbour(other, "similar", starts)


def of_same_period(
    mine: Effect, values: Mapping[str, float], scale: Scale, catalogue: Catalogue
) -> dict[str, Mapping[str, float]]:
    """Effects by name, and their parameters, that give one hanging link the same period."""
    body = scale.body
    if not isinstance(body, BodyParameters) or not bool(body.gravity.any()):
        return {}
    rho = factor(mine, values, body)
    if not 0 < rho < math.inf:
        return {}
    equal = {name: entry.same_period(rho, body) for name, entry in catalogue.items() if entry.same_period}
    return {name: found for name, found in equal.items() if found is not None}
