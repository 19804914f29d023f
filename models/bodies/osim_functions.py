"""Numbers and functions of an OpenSim model: linear functions, constants and splines, as its classes define them.

A SimmSpline and a NaturalCubicSpline are cubic splines with no curvature at their ends; a MultiplierFunction scales
another.
"""

from collections.abc import Sequence
from xml.etree.ElementTree import Element

import numpy as np

from invdyn.models.bodies.scalars import BodyError


def numbers(element: Element, key: str, where: str, default: str) -> np.ndarray:
    """Numbers of a child's text, as many as in ``default``. Raises `BodyError`."""
    found = many(element, key, where, default)
    if len(found) != (count := len(default.split())):
        raise BodyError(f"{where}: expected {count} number{'s' * (count > 1)} as {key}, got {len(found)}")
    return found


def many(element: Element, key: str, where: str, default: str = "") -> np.ndarray:
    """All numbers of a child's text. Raises `BodyError` for any other word, and what is not finite."""
    words: Sequence[str] = (element.findtext(key) or default).replace(",", " ").split()
    try:
        found = np.array([float(word) for word in words])
    except ValueError:
        raise BodyError(f"{where}: expected numbers as {key}, got {' '.join(words)!r:.60}") from None
    if not np.isfinite(found).all():
        raise BodyError(f"{where}: expected finite numbers as {key}, got {' '.join(words)!r:.60}")
    return found


def unwrapped(function: Element | None, where: str) -> tuple[Element | None, float]:
    """A function without its multipliers, and their product."""
    scale = 1.0
    while function is not None and (function.tag == "MultiplierFunction" or function.tag == "function"):
        if function.tag == "MultiplierFunction":
            scale *= float(numbers(function, "scale", where, "1")[0])
            function = function.find("function")
        else:
            function = next(iter(function), None)
    return function, scale


def value(function: Element, at: float, where: str) -> float:
    """A function's value. Raises `BodyError` for one of an unknown kind."""
    if function.tag == "Constant":
        return float(numbers(function, "value", where, "0")[0])
    if function.tag == "LinearFunction":
        slope, offset = numbers(function, "coefficients", where, "1 0")
        return float(slope * at + offset)
    if function.tag in ("SimmSpline", "NaturalCubicSpline", "PiecewiseLinearFunction"):
        x, y = (many(function, key, where) for key in ("x", "y"))
        if len(x) == len(y) >= 2 and (np.diff(x) > 0).all():
            from scipy.interpolate import CubicSpline  # half a second to import, which most runs do not need

            straight = function.tag == "PiecewiseLinearFunction" or len(x) < 3
            return float(np.interp(at, x, y) if straight else CubicSpline(x, y, bc_type="natural")(at))
        raise BodyError(f"{where}: expected a curve with increasing x, and a y for each")
    raise BodyError(f"{where}: expected a linear function, a constant or a spline at each axis, got {function.tag:.60}")
