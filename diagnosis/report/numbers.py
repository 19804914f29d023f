"""Numbers as a reader wants them: to the digits that their uncertainty supports, in units of a handy size.

A number and its unit stay on one line: the space between them is one that does not break.
"""

import math
from collections.abc import Callable, Mapping
from typing import TypeGuard

import numpy as np

from invdyn.diagnosis.assessment.digits import decimals
from invdyn.diagnosis.assessment.result import Estimate
from invdyn.diagnosis.rules import FIXED

NOTHING = "–"
"""Stands for a number that was not measured."""

HANDY = {
    "m": (0.1, 1e3, "mm"),
    "s": (0.1, 1e3, "ms"),
    "kg": (0.1, 1e3, "g"),
    "rad": (math.inf, 180 / math.pi, "°"),
    "rad/s": (math.inf, 180 / math.pi, "°/s"),
}
"""Unit → size under which it is changed, factor, unit that it is changed to."""


def known(value: float | None) -> TypeGuard[float]:
    """Whether there is a finite number at all."""
    return value is not None and math.isfinite(value)


def fixed(value: float | None, places: int) -> str:
    """`value` to so many decimal places, with a true minus sign and a power of ten where it needs one."""
    if not known(value):
        return NOTHING
    if places > 5 or places < -3:
        exponent = max(math.floor(math.log10(abs(value))) if value else -places, -places)
        number = _signed(f"{value / 10.0**exponent:.{places + exponent}f}")
        return number if number == "0" else f"{number} × 10{_superscript(exponent)}"
    return _signed(f"{round(value, places):.{max(places, 0)}f}")


def plain(value: float | None, digits: int = 3) -> str:
    """`value` to so many significant digits, where nothing is known of its uncertainty."""
    if not known(value):
        return NOTHING
    if value == 0:
        return "0"
    return fixed(value, min(digits - 1 - math.floor(math.log10(abs(value))), 9))


def percent(share: float | None) -> str:
    """A probability or share, "97 %"; near certainty one digit more, and never a flat 0 or 100 that is not meant."""
    if not known(share):
        return NOTHING
    if 0 < share < 0.001:
        return "<\u00a00.1\u00a0%"
    if 0.9995 <= share < 1:
        return ">\u00a099.9\u00a0%"
    return f"{fixed(100 * share, 1 if 0.99 < share < 0.9995 or 0 < share < 0.01 else 0)}\u00a0%"


def handy(value: float | None, unit: str, digits: int = 2) -> str:
    """A number with its unit, two digits."""
    factor, unit = _handy(value, unit)
    return with_unit(plain(value * factor, digits) if known(value) else NOTHING, unit)


def apart(write: Callable[[float | None, int], str], *values: float | None, digits: int = 2) -> list[str]:
    """Numbers as ``write`` has them, to as many more ``digits`` as tell them apart where they are not the same."""
    different = len(set(filter(known, values)))
    for more in range(digits, FIXED.max_digits + 1):
        texts = [write(value, more) for value in values]
        if len({text for text, value in zip(texts, values, strict=True) if known(value)}) >= different:
            break
    return texts


def handies(unit: str, *values: float | None) -> list[str]:
    """Numbers of one kind, each with its unit, distinct (:func:`apart`)."""
    return apart(lambda value, digits: handy(value, unit, digits), *values)


def changed(unit: str, before: float | None, after: float | None, interval: tuple[float, float]) -> tuple[str, ...]:
    """What a number was, what it is with its unit, and the ends of its interval, distinct (:func:`apart`)."""
    (old, new), (low, high) = (apart(plain, *two, digits=3) for two in ((before, after), interval))
    return old, with_unit(new, unit), low, high


def estimate(e: Estimate) -> tuple[str, str]:
    """A posterior's mean with its unit, and its 90 % interval in the same unit."""
    factor, unit = _handy(max(map(abs, (e.mean, *e.interval_90))), e.unit)
    width = e.sd if known(e.sd) and e.sd > 0 else abs(e.interval_90[1] - e.interval_90[0]) / 3.29
    if known(width) and width > 0:
        places = decimals(width * factor)
        numbers = [fixed(v * factor, places) for v in (e.mean, *e.interval_90)]
    else:
        numbers = [plain(v * factor, 4) for v in (e.mean, *e.interval_90)]
    return with_unit(numbers[0], unit), with_unit(f"{numbers[1]} to {numbers[2]}", unit)


def plus_minus(value: float, sd: float, unit: str) -> str:
    """A number and its standard deviation."""
    places = decimals(sd) if known(sd) and sd > 0 else 3
    return with_unit(f"{fixed(value, places)} ± {fixed(sd, places)}", unit)


def largest(shares: Mapping[str, float]) -> tuple[str, float] | None:
    """The name with the largest share, the first of equals; None where there is none above zero."""
    finite = {name: share for name, share in shares.items() if known(share) and share > 0}
    return max(finite.items(), key=lambda item: item[1]) if finite else None


def _handy(value: float | None, unit: str) -> tuple[float, str]:
    limit, factor, better = HANDY.get(unit, (0.0, 1.0, unit))
    return (factor, better) if known(value) and abs(value) < limit else (1.0, unit)


def with_unit(number: str, unit: str) -> str:
    """A number and its unit on one line."""
    if unit in ("", "–", "-", "1"):
        return number
    return f"{number}{unit}" if unit == "°" else f"{number}\u00a0{unit}"


def _signed(text: str) -> str:
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text.replace("-", "−")


def _superscript(exponent: int) -> str:
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def root_mean_square(values: np.ndarray) -> float | None:
    """Root mean square of what is finite; None of nothing."""
    seen = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(seen**2))) if seen.size else None
