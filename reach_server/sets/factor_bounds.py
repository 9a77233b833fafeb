"""What constraints leave of the factors of a constrained zonotope: certified bounds, and the set over these."""

import numpy as np

from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import FloatArray
from reach_server.sets import support
from reach_server.sets.parts import Parts
from reach_server.sets.precise import remainder

#: Factors are never rescaled to less than this half-width: rounding of the rows would grow into contradictions.
NARROWEST = 1e-5


def factor_bounds(matrix: FloatArray, offset: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bounds (lower, upper) (..., g) of the factors with ``Aβ = b``, ``|β| <= 1``: outer, certified by duality.

    [-1, 1] where there are no such factors.
    """
    g = matrix.shape[-1]
    unit = np.eye(g)
    found = support.solve(np.zeros(g), unit, matrix, offset, np.concatenate([unit, -unit]))
    bound = np.where(found.empty, 1.0, np.minimum(found.bound, 1.0))
    lower, upper = np.maximum(-bound[..., g:], -1.0), np.maximum(bound[..., :g], -1.0)
    # Bounds that cross by more than rounding are those of a set that is empty, if not provably so.
    nothing = lower - upper > NARROWEST
    lower, upper = np.where(nothing, -1.0, lower), np.where(nothing, 1.0, upper)
    return np.minimum(lower, upper), np.maximum(lower, upper)


def rescale(parts: Parts) -> Parts:
    """The same set over factors that the constraints let reach both of their bounds: exact ([SDB+16], eq. 24).

    With ``β = m + Rβ'`` for the certified bounds ``m ± R``: ``c + Gm``, ``GR``, ``AR``, ``b - Am``. The paper bounds
    the factors by interval propagation; linear programs give the least bounds. A factor that has less than
    ``NARROWEST`` left is not rescaled: one that is tied down has no bounds to reach, and each time its rows would lose
    digits. ``b - Am`` is summed in twice the precision: it is small beside its terms where ``AR`` is small, and its
    rounding would contradict the other rows.
    """
    center, generators, matrix, offset = parts
    lower, upper = factor_bounds(matrix, offset)
    narrow = upper - lower < 2 * NARROWEST
    middle, half = around(np.where(narrow, -1.0, lower), np.where(narrow, 1.0, upper))
    return (
        center + (generators @ middle[..., None])[..., 0],
        generators * half[..., None, :],
        matrix * half[..., None, :],
        remainder(offset, matrix, middle),
    )


def within_bounds(parts: Parts) -> tuple[FloatArray, FloatArray]:
    """Center and generators of a zonotope around a set: each factor over what the constraints leave it, outer."""
    center, generators, matrix, offset = parts
    middle, half = around(*factor_bounds(matrix, offset))
    return center + (generators @ middle[..., None])[..., 0], generators * half[..., None, :]


def around(lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Middle and half-width, rounded up, of intervals."""
    middle = (lower + upper) / 2
    return middle, np.maximum(upper - middle, middle - lower) * (1.0 + 2 * EPS)
