"""Cosine and sine of an angle as a straight-line program, so that machine code computes them lane by lane.

Argument reduction in three parts (W. J. Cody and W. Waite, Software Manual for the Elementary Functions, 1980),

    n = round(2x/π),    r = ((x − n p₁) − n p₂) − n p₃,    |r| ≤ π/4,    p₁ + p₂ + p₃ = π/2

where n p₁ and n p₂ are exact, then minimax polynomials of r² (S. L. Moshier, Cephes 2.2, sin.c and sinf.c), and their
exchange and sign by n mod 4. The error is at most the type's ε (1.2e-7, 2.2e-16) up to 10⁴ rad in float32 and 10⁶ rad
in float64. Of a larger angle they are those of one that differs by its rounding, and stay in [−1, 1]. NaN and infinite
angles give NaN.
"""

from functools import cache

import torch
from torch import Tensor

from invdyn.models.dynamics.traced.expressions import Expression, Graph, Scalar
from invdyn.models.dynamics.traced.programs import Program, program

ANGLE, FUNCTIONS = "q", ("cos", "sin")
"""Words of programs: the angle, and its functions that come in as arguments of their own."""

PARTS = {
    torch.float32: (1.5703125, 4.837512969970703125e-4, 7.549789948768648e-8),
    torch.float64: (1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21),
}
SINE = {
    torch.float32: (-1.9515295891e-4, 8.3321608736e-3, -1.6666654611e-1),
    torch.float64: (
        1.58962301576546568060e-10,
        -2.50507477628578072866e-8,
        2.75573136213857245213e-6,
        -1.98412698295895385996e-4,
        8.33333333332211858878e-3,
        -1.66666666666666307295e-1,
    ),
}
COSINE = {
    torch.float32: (2.443315711809948e-5, -1.388731625493765e-3, 4.166664568298827e-2),
    torch.float64: (
        -1.13585365213876817300e-11,
        2.08757008419747316778e-9,
        -2.75573141792967388112e-7,
        2.48015872888517045348e-5,
        -1.38888888888730564116e-3,
        4.16666666666665929218e-2,
    ),
}
TWO_OVER_PI = 0.636619772367581343076
WIDEST = 0.8
"""rad, a little more than π/4: what is further off is the rounding of a very large angle."""


def inputs(traced: Program) -> list[str]:
    """Words of what a program's machine code takes: the angles in place of their functions."""
    return sorted({ANGLE if word in FUNCTIONS else word for word in traced.words})


@cache
def cosine_and_sine(dtype: torch.dtype) -> Program:
    """The program of one argument x, rad, whose results are cos x and sin x."""
    graph = Graph()
    x = graph.argument((ANGLE, 0), moving=True)
    return program(graph, _traced(x, dtype))


def turned(angles: Tensor) -> dict[str, Tensor]:
    """Cos and sin of angles (...), rad, by word; torch runs the same program, to the same bits."""
    found = cosine_and_sine(angles.dtype).values([angles], [])
    return dict(zip(FUNCTIONS, found, strict=True))


def _traced(x: Expression, dtype: torch.dtype) -> list[Scalar]:
    n = (x * TWO_OVER_PI).rounded()
    r: Expression = x
    for part in PARTS[dtype]:
        r = r - n * part
    r = r.clamped(WIDEST)
    square = r * r
    sine = r + r * (square * _polynomial(square, SINE[dtype]))
    cosine = 1.0 - square * 0.5 + square * square * _polynomial(square, COSINE[dtype])

    half = (n * 0.5).floored()
    is_odd = n - half * 2.0
    sign = 1.0 - (half - (half * 0.5).floored() * 2.0) * 2.0
    return [sign * is_odd.chosen(-sine, cosine), sign * is_odd.chosen(cosine, sine)]


def _polynomial(x: Expression, coefficients: tuple[float, ...]) -> Expression:
    """By Horner's scheme, the highest power's coefficient first."""
    value = x * coefficients[0] + coefficients[1]
    for coefficient in coefficients[2:]:
        value = x * value + coefficient
    return value
