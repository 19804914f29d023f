"""Neighbours of an effect: what a search may put in its place, with the values that it begins from.

    twin        an exact stand-in, from the values of its own parameters (``Effect.twins``); of one link that hangs and
                is left to itself, all that change its period (:mod:`.period_equivalents`)
    wider       what contains it (``Effect.contains``), from where the two are the same
    narrower    its special case, where its own parameters allow that, from those known best
    alike       what much of it is taken for (``Effect.starts_of``), from several values

Its softer form is the same effect, without some idealisation (``Effect.softened``).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from invdyn.models.bodies.body import BodyParameters
from invdyn.models.effects import period_equivalents as period
from invdyn.models.effects.base import Effect
from invdyn.models.effects.scale import Scale

ALLOWED = 3.0
"""Standard deviations from a special case up to which an effect's parameters allow it."""

Kind = Literal["twin", "wider", "narrower", "alike"]


@dataclass(frozen=True)
class Neighbour:
    """An effect in the place of another.

    Attributes:
        effect: bound.
        kind: of neighbour; see the top of the file.
        starts: its parameters' values, by their own names, to begin from; those left out have none of their own.
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
) -> Iterator[Neighbour]:
    """Neighbours among the ``candidates``, all bound, of an effect with these values and their standard deviations.

    By the parameters' own names; ``passive`` if no motor acts.
    """
    one, body = len(scale.torque) == 1, scale.body
    # in space an effect may have other parameters, and then no twin
    twins = {
        other: {its: values[own] for own, its in same.items()}
        for other, same in mine.twins.items()
        if same.keys() <= values.keys()
    }
    swings = one and passive and isinstance(body, BodyParameters) and bool(body.gravity.any())
    if swings and mine.name in period.NAMES:
        twins |= period.equivalents(period.factor(mine, values, body), body)

    def whole(effect: Effect) -> bool:
        """Whether it is that of the whole arm."""
        return one or not effect.where

    for other in candidates:
        here = other.where == mine.where
        if other.name in twins and other.form is None and other.key != mine.key and whole(mine) and whole(other):
            yield Neighbour(other, "twin", [twins[other.name]])
        if here and (names := other.contains.get(mine.name)):
            yield Neighbour(other, "wider", [{name: values[its] for name, its in names.items()}])
        if here and (names := mine.contains.get(other.name)):
            worst_first = sorted(names, key=lambda name: -sd[name])
            same = {names[name]: values[name] for name in worst_first}
            if all(abs(values[name] - same[its]) <= ALLOWED * sd[name] for name, its in names.items()):
                yield Neighbour(other, "narrower", [same])
        if starts := mine.starts_of(other, values, scale):
            yield Neighbour(other, "alike", starts)
