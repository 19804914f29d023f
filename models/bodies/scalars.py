"""The scalars of a body: a plain number, a prior, or a parameter to be learned; and the checks of them."""

import difflib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any, TypeAlias

import pyro.distributions as dist
import torch

UNITS = {"length": "m", "mass": "kg", "com": "m", "inertia": "kg·m²"}
QUANTITIES = tuple(UNITS)
SMALLEST = {"length": 1e-6, "mass": 1e-9, "inertia": 1e-21}
"""A micrometre, a microgram, and less than a fly's leg: what is smaller, but not 0, is a slip of the unit."""
MAX_NUMBER = 1e7
"""Of any number of a body, in its unit: products of a few of them stay within a float's range."""
MAX_LENGTH, MAX_MASS = 30.0, 1e5
"""m and kg of a link: no longer than a crane's boom, no heavier than a crane. A limb in millimetres is longer."""
LARGEST_NAME = 100
"""Characters."""
KNOWN, UNKNOWN = 1e-7, 10.0
"""Relative sd of a prior: below, the number is known; above, a log-normal has no middle."""


class BodyError(ValueError):
    """A body, or a body file, that cannot be meant: the message says what was expected and what came."""


@dataclass(frozen=True)
class Learned:
    """A scalar that is optimised instead of given: a `pyro.param` that begins at `start`."""

    start: float


Scalar: TypeAlias = float | dist.Distribution | Learned


def nominal(value: Scalar) -> float:
    """The scalar as a float: a prior stands at its mean, a learned one at its start."""
    if isinstance(value, dist.Distribution):
        return float(value.mean)
    return value.start if isinstance(value, Learned) else value


def prior(mean: float, sd: float) -> dist.Distribution:
    """A prior of that mean and sd: log-normal, or normal for a mean ≤ 0 (a com at or behind its joint).

    Raises `BodyError` for a sd that is no part of a positive mean from 10⁻⁷ to 10.
    """
    if mean > 0 and not KNOWN * mean <= sd <= UNKNOWN * mean:
        raise BodyError(
            f"expected a sd from {KNOWN:.0e} to {UNKNOWN:g} times the mean {mean:g}, got {sd:g}; "
            "where the number is known, write it alone"
        )
    middle, width = torch.tensor(mean, dtype=torch.float64), torch.tensor(sd, dtype=torch.float64)
    if mean <= 0:
        return dist.Normal(middle, width)
    variance = torch.log1p((width / middle) ** 2)
    return dist.LogNormal(middle.log() - variance / 2, variance.sqrt())


def in_normal_units(distribution: dist.Distribution) -> tuple[float, float, float | None]:
    """Of a prior as θ₀ exp(s z), or θ₀ + u z where θ may be negative, z ~ N(0, s²): θ₀, s and u, which is then s = 1.

    One that is neither log-normal nor normal counts as that of its mean and sd. Raises `BodyError` as :func:`prior`.
    """
    if isinstance(distribution, dist.LogNormal):
        return math.exp(float(distribution.loc)), float(distribution.scale), None
    if isinstance(distribution, dist.Normal):
        return float(distribution.loc), 1.0, float(distribution.scale)
    return in_normal_units(prior(float(distribution.mean), float(distribution.stddev)))


def checked(value: Scalar, quantity: str, where: str) -> Scalar:
    """Return a scalar of a link, numbers as float. Raises `BodyError`, which begins with `where`."""
    what = f"{where}: {quantity} in {UNITS[quantity]}"
    if quantity == "com":
        return checked_scalar(value, what, signed=True)
    largest = {"length": MAX_LENGTH, "mass": MAX_MASS}.get(quantity, MAX_NUMBER)
    positive = quantity in ("length", "mass")
    return checked_scalar(value, what, positive=positive, smallest=SMALLEST[quantity], largest=largest)


def checked_scalar(
    value: Scalar,
    what: str,
    signed: bool = False,
    positive: bool = False,
    smallest: float = 0.0,
    largest: float = MAX_NUMBER,
) -> Scalar:
    """Return a scalar, numbers as float. Raises `BodyError`, which begins with `what`.

    One that is not ``signed`` is not negative, and not 0 where it is ``positive`` or learned. None is between 0 and
    ``smallest``, or beyond ``largest``, but for its sign.
    """
    if isinstance(value, dist.Distribution):
        if value.shape() != ():
            raise BodyError(f"{what}: expected a scalar prior, got one of shape {tuple(value.shape())}")
        if not signed and bool(value.support.check(torch.tensor(-1e-6))):
            raise BodyError(f"{what}: the prior allows negative values; use a LogNormal, for example")
        if not isinstance(value, dist.Normal | dist.LogNormal):
            try:
                in_normal_units(value)  # as a fit takes it
            except ValueError as error:
                raise BodyError(f"{what}: {error}") from None
    elif isinstance(value, Learned):
        value = Learned(number(value.start, what))
    else:
        value = number(value, what)
    centre = number(nominal(value), what)
    if centre < 0 and not signed:
        raise BodyError(f"{what}: expected no negative number, got {centre:g}")
    if centre == 0 and not signed and (positive or isinstance(value, Learned)):
        raise BodyError(f"{what}: expected a positive number, got 0")
    if 0 < abs(centre) < smallest:
        raise BodyError(f"{what}: expected {smallest:.0e} or more, got {centre:g}; is the unit right?")
    if abs(centre) > largest:
        raise BodyError(f"{what}: expected up to {largest:g}, as of any arm, got {centre:g}; is the unit right?")
    return value


def checked_scalars(values: object, count: int, what: str, largest: float = MAX_NUMBER) -> tuple[Scalar, ...]:
    """Return `count` scalars of either sign, up to ``largest``. Raises `BodyError`, which begins with `what`."""
    if isinstance(values, str) or not isinstance(values, Iterable) or len(values := tuple(values)) != count:
        raise BodyError(f"{what}: expected {count} numbers, got {values!r:.60}")
    return tuple(checked_scalar(value, what, signed=True, largest=largest) for value in values)


def number(value: object, what: str) -> float:
    """Return a real number within ±`MAX_NUMBER` as float. Raises `BodyError`, which begins with `what`."""
    if isinstance(value, Real) and not isinstance(value, bool):
        real: Any = value  # of any kind, as NumPy's; the abstract class has no comparison with a float
        if -MAX_NUMBER <= real <= MAX_NUMBER:
            return float(value)
        if math.inf > abs(real):  # an integer may be beyond every float, and too long to be shown
            shown = "a larger one" if isinstance(value, int) else f"{value:g}"
            raise BodyError(f"{what}: expected a number up to {MAX_NUMBER:.0e}, got {shown}; is the unit right?")
    raise BodyError(f"{what}: expected a finite number, got {value!r:.60}")


def check_name(name: object, what: str) -> None:
    """Raise `BodyError` unless `name` is a text of printed characters, not blank, and not long."""
    if not isinstance(name, str) or not name.strip():
        raise BodyError(f"{what}: expected a text that is not blank, got {name!r:.60}")
    if not name.isprintable() or len(name) > LARGEST_NAME:
        raise BodyError(f"{what}: expected up to {LARGEST_NAME} characters that can be printed, got {name!r:.60}")


def check_keys(given: Iterable[str], known: Sequence[str], where: str) -> None:
    """Raise `BodyError` for the first key of `given` that is not in `known`, with the closest known one."""
    for key in given:
        if key not in known:
            close = difflib.get_close_matches(str(key), known, n=1)
            hint = f" (did you mean '{close[0]}'?)" if close else ""
            raise BodyError(f"{where}: unknown key '{key}'{hint}; known keys are {', '.join(known)}")
