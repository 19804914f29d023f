"""Vectors (3 scalars) and matrices (3 rows of 3) of expressions, written out; symmetric ones are computed once."""

from collections.abc import Callable, Sequence

from invdyn.models.dynamics.traced.expressions import Scalar

Vector = Sequence[Scalar]
Matrix = Sequence[Vector]

ZERO: Vector = (0.0, 0.0, 0.0)
NOTHING: Matrix = (ZERO, ZERO, ZERO)
UNIT: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def add(*vectors: Vector) -> Vector:
    """The sum of vectors."""
    return [_sum(entries) for entries in zip(*vectors, strict=True)]


def subtract(a: Vector, b: Vector) -> Vector:
    """A − b."""
    return [x - y for x, y in zip(a, b, strict=True)]


def scale(factor: Scalar, a: Vector) -> Vector:
    """A vector times a scalar."""
    return [factor * x for x in a]


def dot(a: Vector, b: Vector) -> Scalar:
    """A · b."""
    return _sum([x * y for x, y in zip(a, b, strict=True)])


def cross(a: Vector, b: Vector) -> Vector:
    """A × b."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def cross_matrix(a: Vector) -> Matrix:
    """The matrix of a ×."""
    return [[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]]


def transpose(m: Matrix) -> Matrix:
    """Mᵀ."""
    return [list(column) for column in zip(*m, strict=True)]


def apply(m: Matrix, a: Vector) -> Vector:
    """M a."""
    return [dot(row, a) for row in m]


def multiply(m: Matrix, n: Matrix) -> Matrix:
    """M N."""
    return [[dot(row, column) for column in transpose(n)] for row in m]


def symmetric(entry: Callable[[int, int], Scalar]) -> Matrix:
    """The symmetric matrix of an entry's function, which is evaluated for the upper triangle alone."""
    upper = {(i, j): entry(i, j) for i in range(3) for j in range(i, 3)}
    return [[upper[min(i, j), max(i, j)] for j in range(3)] for i in range(3)]


def matrix_sum(*matrices: Matrix) -> Matrix:
    """The sum of matrices."""
    return [add(*rows) for rows in zip(*matrices, strict=True)]


def conjugate(rotation: Matrix, m: Matrix, is_symmetric: bool) -> Matrix:
    """R M Rᵀ."""
    half = multiply(rotation, m)
    if is_symmetric:
        return symmetric(lambda i, j: dot(half[i], rotation[j]))
    return [[dot(row, other) for other in rotation] for row in half]


def _sum(values: Sequence[Scalar]) -> Scalar:
    total: Scalar = 0.0
    for value in values:
        total = total + value
    return total
