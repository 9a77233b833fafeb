"""Fewer generators: enclosures of a zonotope by one of lower order.

Each reduction encloses the sum of the generators it gives up in a parallelotope, whose half-lengths are rounded
outwards: their sums by one ulp a term, and for the parallelotopes that are no boxes what the products lose, too. The
compiled recursion reduces by ``kernels.order_reduction``, which rounds by a factor instead.
"""

from typing import Literal

import numpy as np

from reach_server.numeric.checks import SetError, stack_rows
from reach_server.numeric.rounding import EPS, sum_up
from reach_server.numeric.types import BoolArray, FloatArray

ReductionMethod = Literal["girard", "combastel", "pca", "scott"]


def generator_count(order: float, dimension: int) -> int:
    """The generators ``order * n`` that a set of that order may have; ``SetError`` unless the order is positive."""
    try:
        value = float(order)
    except (TypeError, ValueError):
        raise SetError(f"order is {order!r}, expected a positive number") from None
    if not value > 0:
        raise SetError(f"order is {order}, expected a positive number")
    return int(min(value * dimension, 2.0**31))


def reduce_generators(generators: FloatArray, count: int, method: ReductionMethod = "girard") -> FloatArray:
    """Generators (..., n, g) of an enclosing zonotope with at most ``max(count, n)`` columns; an outer bound.

    Returned unchanged if there are few enough columns. Raises ``SetError`` for an unknown method.
    """
    methods = {"girard": girard, "combastel": combastel, "pca": pca, "scott": scott}
    if method not in methods:
        raise SetError(f"method is {method!r}, expected one of {', '.join(methods)}")
    return methods[method](generators, count)


def reduce_lifted(
    generators: FloatArray, matrix: FloatArray, count: int, method: ReductionMethod
) -> tuple[FloatArray, FloatArray]:
    """Generators (..., n, g) and constraint matrix (..., c, g) of an enclosing set with at most ``max(count, n + c)``
    columns: outer; the number of columns stays where there are few enough.

    The zonotope of ``(Gβ, Aβ)`` is enclosed as one and the constraints are kept [SDB+16, section 4.3].
    """
    n, rows = generators.shape[-2], matrix.shape[-2]
    lifted = stack_rows(generators, matrix)
    # Powers of two, which round nothing: generators of unlike coordinates and rows are ranked alike.
    unit = _power_of_two(np.abs(lifted).sum(axis=-1, keepdims=True))
    reduced = unit * reduce_generators(lifted / unit, max(count, n + rows), method)
    return reduced[..., :n, :], reduced[..., n:, :]


def girard(generators: FloatArray, count: int) -> FloatArray:
    """Generators (..., n, g) of an enclosing zonotope with at most ``max(count, n)`` columns; an outer bound.

    Keeps the columns that are least like a box and encloses the sum of the others by a box, whose n columns
    come last [Gir05]. Each set of the batch is reduced by its own ranking. Returned unchanged
    if there are few enough columns.
    """
    n, g = generators.shape[-2:]
    if g <= max(count, n):
        return generators
    size = np.abs(generators)
    kept, others = _split(generators, size.sum(axis=-2) - size.max(axis=-2), max(count, n) - n)
    return _with_box(kept, others)


def combastel(generators: FloatArray, count: int) -> FloatArray:
    """Like ``girard``, but keeps the longest columns [Com03]; an outer bound."""
    n, g = generators.shape[-2:]
    if g <= max(count, n):
        return generators
    kept, others = _split(generators, (generators**2).sum(axis=-2), max(count, n) - n)
    return _with_box(kept, others)


def pca(generators: FloatArray, count: int) -> FloatArray:
    """Like ``girard``, but the others are enclosed by a box along their principal axes [KSA17]; an
    outer bound. Where the axis-parallel box has less volume it is taken."""
    n, g = generators.shape[-2:]
    if g <= max(count, n):
        return generators
    size = np.abs(generators)
    kept, others = _split(generators, size.sum(axis=-2) - size.max(axis=-2), max(count, n) - n)
    scaled = others / _power_of_two(np.abs(others).max(axis=(-2, -1), keepdims=True, initial=0.0))
    axes = np.linalg.svd(scaled @ np.swapaxes(scaled, -1, -2))[0]
    turned, straight = parallelotope(axes, others), _box(others)
    with np.errstate(divide="ignore"):
        # Both are orthogonal: the lengths of their columns make the volume.
        larger = np.log(_lengths(turned)).sum(axis=-1) >= np.log(_lengths(straight)).sum(axis=-1)
    return np.concatenate([kept, np.where(larger[..., None, None], straight, turned)], axis=-1)


def scott(generators: FloatArray, count: int) -> FloatArray:
    """Columns are given up one by one, each the one that enlarges a parallelotope of n columns by the least volume
    ([SDB+16], appendix; compared in [KSA17]); an outer bound.

    The parallelotope's axes are columns chosen by elimination with pivoting, coordinates scaled to their widths;
    where the columns span no more than a flat, coordinate axes of length 0 complete them.
    """
    n, g = generators.shape[-2:]
    if g <= max(count, n):
        return generators
    # A power of two: dividing by it rounds nothing.
    widths = _power_of_two(np.abs(generators).sum(axis=-1, keepdims=True))
    scaled = generators / widths
    axes, length, absorbed = _pivots(scaled)
    shares = np.abs(np.linalg.solve(axes, scaled))
    kept = max(count, n) - n
    # A flat set has fewer columns among the axes, so more are left to give up.
    for _ in range(g - kept - int(absorbed.sum(axis=-1).min(initial=g))):
        ratio = shares / np.maximum(length, 1e-6)[..., None]
        growth = np.where(absorbed, np.inf, np.prod(1 + ratio, axis=-2) - 1 - ratio.sum(axis=-2))
        best = growth.argmin(axis=-1)[..., None]
        goes_on = absorbed.sum(axis=-1, keepdims=True) < g - kept
        length = length + np.where(goes_on, np.take_along_axis(shares, best[..., None, :], axis=-1)[..., 0], 0.0)
        before = np.take_along_axis(absorbed, best, axis=-1)
        np.put_along_axis(absorbed, best, before | goes_on, axis=-1)
    order = np.argsort(absorbed, axis=-1, kind="stable")[..., None, :]
    stays = np.take_along_axis(generators, order[..., :kept], axis=-1)
    others = np.take_along_axis(scaled, order[..., kept:], axis=-1)
    return np.concatenate([stays, widths * parallelotope(axes, others)], axis=-1)


def _pivots(scaled: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Unit vectors (..., n, n) that span the space, their lengths (..., n), and which columns (..., g) they are.

    Each is the column that reaches farthest out of the span of those before it; a coordinate axis, of length 0, where
    none does by 1e-8 of the widths.
    """
    n, g = scaled.shape[-2:]
    unit = np.broadcast_to(np.eye(n), (*scaled.shape[:-1], n))
    pool = np.concatenate([scaled, unit], axis=-1)
    handicap = np.concatenate([np.ones(g), np.full(n, 1e-8)])
    rest = np.array(pool)
    chosen = []
    for _ in range(n):
        best = (_lengths(rest) * handicap).argmax(axis=-1)[..., None, None]
        chosen.append(best[..., 0])
        normal = np.take_along_axis(rest, best, axis=-1)
        normal = normal / _lengths(normal)[..., None, :]
        for _ in range(2):  # twice: the first projection leaves rounding in the span
            rest = rest - normal * (np.swapaxes(normal, -1, -2) @ rest)
        np.put_along_axis(rest, np.broadcast_to(best, (*rest.shape[:-1], 1)), 0.0, axis=-1)
    index = np.concatenate(chosen, axis=-1)
    columns = np.take_along_axis(pool, index[..., None, :], axis=-1)
    length = _lengths(columns)
    taken = np.zeros((*scaled.shape[:-2], g + n), dtype=bool)
    np.put_along_axis(taken, index, True, axis=-1)
    return columns / length[..., None, :], np.where(index < g, length, 0.0), taken[..., :g]


def parallelotope(axes: FloatArray, generators: FloatArray) -> FloatArray:
    """Columns (..., n, n) along the invertible ``axes`` (..., n, n) whose zonotope holds that of ``generators``: outer.

    ``x = T (T⁻¹ x)``: the half-lengths are ``Σ |T⁻¹ g|``. What solving and multiplying lose is measured by the residual
    ``g - T s``, enlarged by the rounding of computing it, and covered by ``|T⁻¹|`` times that.
    """
    n = axes.shape[-1]
    inverse = np.linalg.inv(axes)
    shares = inverse @ generators
    lost = np.abs(generators - axes @ shares) + (n + 3) * EPS * (np.abs(axes) @ np.abs(shares) + np.abs(generators))
    length = sum_up(np.abs(shares)) + 2.0 * (np.abs(inverse) @ lost.sum(axis=-1)[..., None])[..., 0]
    return np.asarray(axes * (length * (1.0 + 4 * EPS))[..., None, :])


def boxed(generators: FloatArray, count: int) -> FloatArray:
    """Like ``girard``, but the last n columns of the result always form a diagonal matrix; an outer bound.

    A caller that has to enlarge the set in some coordinate (rounding) can do it on these columns.
    """
    n, g = generators.shape[-2:]
    box = np.zeros((*generators.shape[:-2], n, n))
    if g + n <= max(count, n):
        return np.concatenate([generators, box], axis=-1)
    return girard(np.concatenate([generators, box], axis=-1), count)


def _split(generators: FloatArray, rank: FloatArray, kept: int) -> tuple[FloatArray, FloatArray]:
    """The ``kept`` columns of highest rank (..., g), each set of the batch by its own, and the others."""
    order = np.argsort(-rank, axis=-1, kind="stable")
    ranked = np.take_along_axis(generators, order[..., None, :], axis=-1)
    return ranked[..., :kept], ranked[..., kept:]


def _box(generators: FloatArray) -> FloatArray:
    """The box (..., n, n) around the zonotope, half-widths rounded up."""
    return np.asarray(sum_up(np.abs(generators))[..., None] * np.eye(generators.shape[-2]))


def _with_box(kept: FloatArray, others: FloatArray) -> FloatArray:
    return np.concatenate([kept, _box(others)], axis=-1)


def _power_of_two(size: FloatArray) -> FloatArray:
    """The least power of two above each positive number, 1 for zero."""
    return np.asarray(np.where(size > 0, np.ldexp(1.0, np.frexp(size)[1]), 1.0))


def _lengths(columns: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((columns**2).sum(axis=-2)))
