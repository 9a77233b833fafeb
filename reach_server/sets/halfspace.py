"""Cuts with strips, ``{x in Z : lower <= H x <= upper}``: enclosing zonotopes, and constrained ones with a row more."""

import math
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reach_server.numeric.checks import SetError, checked, checked_batch, checked_bounds
from reach_server.numeric.intervals import Interval
from reach_server.numeric.jit import ZERO, reduction_kernel, stacked
from reach_server.numeric.rounding import add_down, add_up
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.sets.kernels.strip import MISSED, WORK, Flags, narrow_one, tightened
from reach_server.sets.parts import Parts, batch_of
from reach_server.sets.polygon import zonotope_area

StripMethod = Literal["tight", "frobenius"]


def known(method: StripMethod) -> StripMethod:
    """The method, if there is one of that name; ``SetError`` otherwise."""
    if method not in get_args(StripMethod):
        raise SetError(f"method is {method!r}, expected one of {', '.join(get_args(StripMethod))}")
    return method


def bounds(q: ArrayLike, r: ArrayLike, batch: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """``q - r`` and ``q + r`` (...) of the strip ``|Hx - q| <= r``, rounded outwards; r = inf: no bounds."""
    middle, radius = _number(q, "q", batch), _radius(r, batch)
    checked_batch(radius, 0, "r", middle.shape)
    finite = np.where(np.isinf(radius), 0.0, radius)
    lower, upper = add_down(middle, -finite), add_up(middle, finite)
    return np.where(np.isinf(radius), -np.inf, lower), np.where(np.isinf(radius), np.inf, upper)


def linearised(
    normal: FloatArray,
    center: FloatArray,
    h0: ArrayLike,
    remainder: tuple[ArrayLike, ArrayLike],
    r: ArrayLike,
    batch: tuple[int, ...],
) -> tuple[FloatArray, FloatArray]:
    """Lower and upper bound (...) of ``J x`` for J (..., n) that ``|h(x)| <= r`` implies: outer.

    ``h(x)`` is in ``h0 + J(x - center) + [lower, upper]``, so ``-r - upper <= h0 + J(x - center) <= r - lower``. Where
    the remainder, or r, is infinite on a side, that side does not bind. Sums are rounded outwards, that of ``J center``
    by its terms.
    """
    value, radius = _number(h0, "h0", batch), _radius(r, batch)
    low, high = (checked_batch(b, 0, "remainder", batch) for b in checked_bounds(remainder, "remainder", ()))
    middle = Interval.of(center).linear_map(normal[..., None, :])[..., 0] - value
    return add_down(middle.lower, -_sum(radius, high)), add_up(middle.upper, _sum(radius, -low))


def _number(value: ArrayLike, name: str, batch: tuple[int, ...]) -> FloatArray:
    return checked_batch(checked(value, name, ()), 0, name, batch)


def _radius(r: ArrayLike, batch: tuple[int, ...]) -> FloatArray:
    radius = checked_batch(checked(r, "r", (), infinite=True), 0, "r", batch)
    if (radius < 0).any():
        raise SetError(f"r must not be negative, its least value is {radius.min()}")
    return radius


def _sum(radius: FloatArray, excess: FloatArray) -> FloatArray:
    """``radius + excess`` rounded up; infinite where one of them is infinite."""
    infinite = np.isinf(radius) | np.isinf(excess)
    return np.where(infinite, np.inf, add_up(np.where(infinite, 0.0, radius), np.where(infinite, 0.0, excess)))


class Narrowed(NamedTuple):
    """Zonotopes after their cuts: ``center`` (..., z), ``generators`` (..., z, g + C), zero beyond the first ``used``
    (...) columns, and the flags ``acted`` (..., C) of the strips (``ACTED``, ``MISSED`` in ``kernels.strip``)."""

    center: FloatArray
    generators: FloatArray
    used: NDArray[np.int64]
    acted: Flags


def strip_bounds(
    center: FloatArray, generators: FloatArray, normal: FloatArray, lower: FloatArray, upper: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray]:
    """The strip tightened to the set: (center (...), radius (...), cuts (...) bool, empty (...) bool).

    ``cuts`` is False where the strip holds on the whole set; ``empty`` is certain: the strip and the set are
    disjoint by more than the rounding of the comparison. The radius includes the rounding of ``normal @ center`` and
    ``normal @ generators``, computed in any order.
    """
    batch = np.broadcast_shapes(
        center.shape[:-1], generators.shape[:-2], normal.shape[:-1], np.shape(lower), np.shape(upper)
    )
    size = math.prod(batch)
    found = _tightened_rows(
        stacked(center, 1, batch, size), stacked(generators, 2, batch, size),
        stacked(normal[..., None, :], 2, batch, size), stacked(np.asarray(lower), 0, batch, size),
        stacked(np.asarray(upper), 0, batch, size), size,
    )  # fmt: skip
    middle, radius, cuts, empty = found
    return middle.reshape(batch), radius.reshape(batch), cuts.reshape(batch), empty.reshape(batch)


def intersect_strip(
    center: FloatArray,
    generators: FloatArray,
    normal: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    *,
    method: StripMethod = "tight",
    plane: tuple[int, int] | None = None,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Center, generators (..., n, g + 1) of a zonotope around the intersection, and where it is certainly empty.

    An outer bound; ``frobenius`` and ``tight`` are those of ``kernels.strip.narrow_one``: the paper's Algorithm 2,
    whose result may be larger than the set, and the best of some λ, whose result never is. Sizes are compared by the
    area in ``plane`` (or of a planar set) times the widths of the other coordinates; without a plane by all widths.

    An empty intersection, and a strip that does not cut, return the set unchanged (with a zero generator).
    """
    found = narrow(
        center, generators, normal[..., None, :], np.asarray(lower)[..., None], np.asarray(upper)[..., None],
        np.ones(1, dtype=bool), method=method, plane=plane,
    )  # fmt: skip
    return found.center, found.generators, (found.acted[..., 0] & MISSED) != 0


def cut_constrained(parts: Parts, normals: FloatArray, lower: FloatArray, upper: FloatArray) -> Parts:
    """The parts with ``lower <= normals @ x <= upper`` (..., K, n), (..., K), K factors and rows more: exact.

    The strips are tightened to the zonotope; one that is certainly missed gets a row that cannot be met.
    """
    center, generators, own_matrix, own_offset = parts
    q, r, cuts, empty = strip_bounds(center[..., None, :], generators[..., None, :, :], normals, lower, upper)
    acts = cuts & ~empty
    heights = normals @ generators
    middle = (normals @ center[..., None])[..., 0]
    batch = np.broadcast_shapes(r.shape[:-1], batch_of(parts))
    count, g = normals.shape[-2], generators.shape[-1]
    rows = own_matrix.shape[-2]
    matrix = np.zeros((*batch, rows + count, g + count))
    offset = np.zeros((*batch, rows + count))
    matrix[..., :rows, :g] = own_matrix
    offset[..., :rows] = own_offset
    matrix[..., rows:, :g] = np.where(acts[..., None], heights, 0.0)
    matrix[..., rows:, g:] = np.where(acts, -r, 0.0)[..., None] * np.eye(count)
    # A missed strip gets the row 0·β = 1.
    offset[..., rows:] = np.where(empty, 1.0, np.where(acts, q - middle, 0.0))
    return center, np.concatenate([generators, np.zeros((*generators.shape[:-1], count))], axis=-1), matrix, offset


def narrow(
    center: FloatArray,
    generators: FloatArray,
    normals: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    active: BoolArray,
    *,
    method: StripMethod = "tight",
    plane: tuple[int, int] | None = None,
) -> Narrowed:
    """Zonotopes around sets (..., z), (..., z, g) cut by those of C strips that are ``active`` (..., C): outer.

    normals (..., C, n) over the first n <= z coordinates, lower and upper (..., C). There is room for one column more a
    strip: ``tight`` cuts without one where that is used up. See ``kernels.strip.narrow_one``.
    """
    batch = np.broadcast_shapes(
        center.shape[:-1], generators.shape[:-2], normals.shape[:-2], lower.shape[:-1], upper.shape[:-1],
        active.shape[:-1],
    )  # fmt: skip
    size, room = math.prod(batch), normals.shape[-2]
    z = generators.shape[-2]
    first, second = (0, 1) if z == 2 else plane or (-1, -1)
    center, generators, used, acted = _narrowed_rows(
        stacked(center, 1, batch, size), stacked(generators, 2, batch, size), stacked(normals, 2, batch, size),
        stacked(lower, 1, batch, size), stacked(upper, 1, batch, size),
        np.ascontiguousarray(np.broadcast_to(active, (*batch, room))).reshape(size, room),
        first, second, method == "frobenius", room, size,
    )  # fmt: skip
    return Narrowed(
        center.reshape(*batch, z), generators.reshape(*batch, z, generators.shape[2]), used.reshape(batch),
        acted.reshape(*batch, room),
    )  # fmt: skip


@reduction_kernel
def _tightened_rows(
    center: FloatArray, generators: FloatArray, normal: FloatArray, lower: FloatArray, upper: FloatArray, count: int
) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray]:
    """``tightened`` for P = ``count`` sets, one strip each: middle, radius, cuts, empty (P,).

    Arrays have P or 1 along their first axis: center (n), generators (n, g), normal (1, n), lower and upper.
    """
    n, g = generators.shape[1:]
    middle, radius = np.zeros(count), np.zeros(count)
    cuts, empty = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    work = np.zeros((WORK, max(n, g)))
    for p in range(count):
        middle[p], radius[p], _, cuts[p], empty[p] = tightened(
            center[p % len(center)], generators[p % len(generators)], g, normal[p % len(normal)], ZERO,
            lower[p % len(lower)], upper[p % len(upper)], work,
        )  # fmt: skip
    return middle, radius, cuts, empty


@reduction_kernel
def _narrowed_rows(
    center: FloatArray,
    generators: FloatArray,
    normals: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    active: BoolArray,
    plane0: int,
    plane1: int,
    frobenius: bool,
    room: int,
    count: int,
) -> tuple[FloatArray, FloatArray, NDArray[np.int64], Flags]:
    """``narrow_one`` for P = ``count`` sets: center (P, z), generators (P, z, g + room), columns used (P,) and flags
    (P, C).

    Arrays have P or 1 along their first axis: center (z), generators (z, g), normals (C, n), lower and upper (C);
    ``active`` (P, C).
    """
    z, g = generators.shape[1:]
    strips, n = normals.shape[1:]
    centers, columns = np.zeros((count, z)), np.zeros((count, z, g + room))
    used, acted = np.zeros(count, dtype=np.int64), np.zeros((count, strips), dtype=np.uint8)
    work = np.zeros((WORK, max(z, g + room)))
    rows, low, high, on = np.zeros((strips, n)), np.zeros(strips), np.zeros(strips), np.zeros(strips, dtype=np.bool_)
    for p in range(count):
        first, second, third = p % len(center), p % len(generators), p % len(normals)
        for k in range(z):
            centers[p, k] = center[first, k]
            for i in range(g):
                columns[p, k, i] = generators[second, k, i]
        for c in range(strips):
            low[c], high[c] = lower[p % len(lower), c], upper[p % len(upper), c]
            on[c] = active[p, c]
            for k in range(n):
                rows[c, k] = normals[third, c, k]
        used[p], _ = narrow_one(
            centers[p], columns[p], g, rows, low, high, on, plane0, plane1, frobenius, acted[p], work
        )  # fmt: skip
    return centers, columns, used, acted


def log_size(generators: FloatArray, plane: tuple[int, int] | None) -> FloatArray:
    """Logarithm of the size that ``tight`` compares (see ``intersect_strip``).

    A factor of zero counts as the least positive number: a coordinate in which the set is a point stays one under
    every candidate, and must not hide what they do to the others.
    """
    tiny = np.finfo(np.float64).tiny
    n = generators.shape[-2]
    if n == 2:
        plane = (0, 1)
    others = [i for i in range(n) if plane is None or i not in plane]
    size = np.log(np.maximum(2 * np.abs(generators[..., others, :]).sum(axis=-1), tiny)).sum(axis=-1)
    if plane is not None:
        size = size + np.log(np.maximum(zonotope_area(generators[..., plane, :]), tiny))
    return np.asarray(size)
