"""Checks of what a tree is given: scalars of either sign, vectors of them, and the order of links."""

from collections.abc import Iterable, Sequence

import pyro.distributions as dist
import torch

from invdyn.models.bodies.scalars import BodyError, Learned, Scalar, nominal, number

WORLD = "world"
"""What a link's parent is called where it hangs on nothing that moves."""


def checked_scalar(value: Scalar, what: str, least: float | None = None, above: bool = False) -> Scalar:
    """Return a scalar, numbers as float. Raises `BodyError`, which begins with `what`, if it can be under `least`.

    With `above` it may not be `least` itself either.
    """
    if isinstance(value, dist.Distribution):
        if value.shape() != ():
            raise BodyError(f"{what}: expected a scalar prior, got one of shape {tuple(value.shape())}")
        if least is not None and bool(value.support.check(torch.tensor(least - 1e-6))):
            raise BodyError(f"{what}: the prior allows values under {least:g}; use a LogNormal, for example")
    elif isinstance(value, Learned):
        value = Learned(number(value.start, what))
    else:
        value = number(value, what)
    centre = number(nominal(value), what)
    if least is not None and (centre < least or (above and centre == least)):
        raise BodyError(f"{what}: expected a number {'>' if above else '≥'} {least:g}, got {centre:g}")
    return value


def checked_scalars(values: object, count: int, what: str) -> tuple[Scalar, ...]:
    """Return `count` scalars of either sign. Raises `BodyError`, which begins with `what`."""
    if isinstance(values, str) or not isinstance(values, Iterable) or len(values := tuple(values)) != count:
        raise BodyError(f"{what}: expected {count} numbers, got {values!r:.60}")
    return tuple(checked_scalar(value, what) for value in values)


def ordered(links: Sequence, where: str) -> tuple:
    """Links with parents before their children, else as given. Raises `BodyError` for unknown parents and a cycle."""
    names = {link.name for link in links}
    for link in links:
        if link.parent != WORLD and link.parent not in names:
            raise BodyError(
                f"{where}: link '{link.name}' hangs on '{link.parent}', which is no link; "
                f"links are {', '.join(link.name for link in links)}, and '{WORLD}' is what does not move"
            )
    placed, waiting, known = [], list(links), {WORLD}
    while waiting:
        ready = next((link for link in waiting if link.parent in known), None)
        if ready is None:
            circle = ", ".join(f"'{link.name}' on '{link.parent}'" for link in waiting)
            raise BodyError(f"{where}: expected a tree, but links hang on each other in a circle: {circle}")
        waiting.remove(ready)
        known.add(ready.name)
        placed.append(ready)
    return tuple(placed)
