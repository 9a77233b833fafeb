"""Does a set lie in another, and are two zonotopes disjoint? Answers for a whole batch first, then linear programs."""

import math
from typing import Any

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import block_array, csr_array, eye_array, kron

from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.sets import outline, support
from reach_server.sets.kernels import membership
from reach_server.sets.parts import Parts, at, batch_of, common_batch

#: By how much, relative to the outer set's reach, a set may stick out and still count as contained.
SLACK = 1e-9
#: The same for the linear programs, whose solver is no more accurate.
PROGRAM_SLACK = 1e-7


def face_normals(generators: FloatArray) -> FloatArray:
    """Directions (..., K, n) across faces of zonotopes: the axes, and in the plane those across every generator, too.

    Up to the plane they and their opposites decide: between two neighbours the support function is linear.
    """
    n = generators.shape[-2]
    axes = np.broadcast_to(np.eye(n), (*generators.shape[:-2], n, n))
    if n != 2:
        return axes
    return np.concatenate([axes, np.stack([-generators[..., 1, :], generators[..., 0, :]], axis=-1)], axis=-2)


def zonotope_contains(
    center: FloatArray, generators: FloatArray, inner_center: FloatArray, inner_generators: FloatArray
) -> BoolArray:
    """True (...) where the second zonotope lies in the first, up to 1e-9 (linear programs: 1e-7) of the first's reach.

    True is certain. In one and two dimensions False is certain, too: the difference of the supports is convex between
    neighbouring edge normals of the outer set, so that the normals decide. Beyond, ``c1 - c = Gγ``, ``G1 = GΓ`` with
    ``|γ| + |Γ| 1 <= 1`` is sufficient [ST19]; it is met by least-norm factors or by a linear program.
    """
    n, g = generators.shape[-2:]
    batch = np.broadcast_shapes(
        center.shape[:-1], generators.shape[:-2], inner_center.shape[:-1], inner_generators.shape[:-2]
    )
    shift = np.broadcast_to(inner_center - center, (*batch, n))
    outer = np.broadcast_to(generators, (*batch, n, g))
    inner = np.broadcast_to(inner_generators, (*batch, *inner_generators.shape[-2:]))
    rounding = 4 * EPS * (np.abs(center) + np.abs(inner_center))
    probes = face_normals(generators)
    reach = np.abs(probes @ generators).sum(axis=-1)
    needed = np.abs((probes @ shift[..., None])[..., 0]) + np.abs(probes @ inner).sum(axis=-1)
    slack = SLACK * reach + (np.abs(probes) @ rounding[..., None])[..., 0]
    slack = slack + (n + g) * EPS * (np.abs(probes) @ np.abs(generators).sum(axis=-1)[..., None])[..., 0]
    possible = np.broadcast_to((needed <= reach + slack).all(axis=-1), batch)
    # A point has no width along the axes: these decide.
    if n <= 2 or not g:
        return possible
    return _by_factors(outer, np.concatenate([shift[..., None], inner], axis=-1), rounding, possible)


def polytope_contains(
    center: FloatArray, generators: FloatArray, normals: FloatArray, heights: FloatArray, size: FloatArray, terms: int
) -> BoolArray:
    """True (...) where ``heights`` (..., K) of another set over ``normals`` (..., K, n), which decide, do not exceed
    those of the zonotope, up to 1e-9 of its reach and the rounding of ``terms`` terms of ``size`` (..., n), the other
    set's coordinates.

    Across a flat set the reach is 0, and the heights are all rounding.
    """
    n, g = generators.shape[-2:]
    reach = np.abs(normals @ generators).sum(axis=-1)
    size = size + np.abs(center) + np.abs(generators).sum(axis=-1)
    rounding = 4 * (n + g + terms + 8) * EPS * (np.abs(normals) @ size[..., None])[..., 0]
    limit = (normals @ center[..., None])[..., 0] + reach * (1 + SLACK) + rounding
    return np.asarray((heights <= limit).all(axis=-1))


def _by_factors(outer: FloatArray, targets: FloatArray, rounding: FloatArray, possible: BoolArray) -> BoolArray:
    """True (...) where ``targets = outer @ Γ`` is solved with row sums of ``|Γ|`` at most 1, up to the ``rounding``
    (..., n) of the centers."""
    batch = possible.shape
    n, g = outer.shape[-2:]
    found = np.zeros(math.prod(batch), dtype=bool)
    outer, targets = outer.reshape(len(found), n, g), targets.reshape(len(found), n, targets.shape[-1])
    rounding = np.broadcast_to(rounding, (*batch, n)).reshape(len(found), n)
    todo = np.flatnonzero(possible)
    # Coordinates are scaled to the outer set's widths, so that the solvers' accuracy is that of the set.
    size = np.abs(outer).sum(axis=-1, keepdims=True)
    scale = np.where(size > 0, size, 1.0)
    outer, targets = outer / scale, np.where(size > 0, targets / scale, 0.0)
    # Far away, rounding of the centers is more than the solvers' accuracy.
    blur = np.where(size > 0, rounding[..., None] / scale, 0.0)
    if len(todo):
        shares = np.linalg.pinv(outer[todo]) @ targets[todo]
        # Shares of short generators are only known to few digits, and matter as little.
        shares = shares / np.maximum(np.abs(shares).sum(axis=-1, keepdims=True), 1.0)
        lost = np.abs(outer[todo] @ shares - targets[todo]).sum(axis=-1, keepdims=True)
        found[todo] = (lost <= SLACK + blur[todo]).all(axis=(-2, -1))
    for index in todo:
        if not found[index]:
            box = (blur[index] * np.eye(n))[:, blur[index, :, 0] > SLACK]
            found[index] = _least_row_sum(np.concatenate([outer[index], box], axis=1), targets[index]) <= (
                1 + PROGRAM_SLACK
            )
    return found.reshape(batch)


def _least_row_sum(outer: FloatArray, targets: FloatArray) -> float:
    """The least greatest row sum of ``|Γ|`` over ``outer @ Γ = targets``; inf where there is no Γ."""
    g, m = outer.shape[1], targets.shape[1]
    equations = np.kron(outer, np.eye(m))
    sums = np.kron(np.eye(g), np.ones((1, m)))
    solution = linprog(
        np.append(np.zeros(2 * g * m), 1.0),
        A_ub=np.concatenate([sums, sums, -np.ones((g, 1))], axis=1),
        b_ub=np.zeros(g),
        A_eq=np.concatenate([equations, -equations, np.zeros((len(equations), 1))], axis=1),
        b_eq=targets.ravel(),
        bounds=(0, None),
        method="highs",
    )
    return float(solution.fun) if solution.status == 0 and solution.fun is not None else np.inf


def certainly_disjoint(
    center: FloatArray, generators: FloatArray, other_center: FloatArray, other_generators: FloatArray
) -> BoolArray:
    """True (...) where a direction separates the two zonotopes by more than rounding: certain.

    In one and two dimensions the directions tried are all that matter (False says that the sets meet, up to rounding);
    beyond, a linear program looks for one where these, and a common point of least-norm factors, fail.
    """
    shift = other_center - center
    n = shift.shape[-1]
    batch = np.broadcast_shapes(shift.shape[:-1], generators.shape[:-2], other_generators.shape[:-2])
    blocks = [np.broadcast_to(b, (*batch, *b.shape[-2:])) for b in (generators, other_generators)]
    joined = np.concatenate(blocks, axis=-1)
    shift = np.broadcast_to(shift, (*batch, n))
    rounding = np.broadcast_to(np.abs(center) + np.abs(other_center), (*batch, n))
    probes = face_normals(joined)
    if n > 2:
        probes = np.concatenate([probes, shift[..., None, :]], axis=-2)
    apart = np.asarray(_separates(probes, shift, joined, rounding).any(axis=-1))
    # Two points are apart along an axis.
    if n <= 2 or not joined.shape[-1]:
        return apart
    sets = math.prod(batch)
    flat = (shift.reshape(sets, n), joined.reshape(sets, n, joined.shape[-1]), rounding.reshape(sets, n))
    result = apart.ravel()
    todo = np.flatnonzero(~result)
    if len(todo):
        factors = (np.linalg.pinv(flat[1][todo]) @ flat[0][todo][..., None])[..., 0]
        size = np.abs(flat[1][todo]).sum(axis=-1)
        lost = np.abs((flat[1][todo] @ factors[..., None])[..., 0] - flat[0][todo])
        meets = (np.abs(factors).max(axis=-1) <= 1) & (lost <= SLACK * size).all(axis=-1)
        todo = todo[~meets]
    for index in todo:
        direction = _separating(flat[0][index], flat[1][index])
        result[index] = _separates(direction[None], flat[0][index], flat[1][index], flat[2][index])[0]
    return result.reshape(batch)


def _separates(directions: FloatArray, shift: FloatArray, generators: FloatArray, rounding: FloatArray) -> BoolArray:
    """True (..., K) where ``|d·shift|`` exceeds the reach of the generators and what the sums may have lost."""
    n, g = generators.shape[-2:]
    size = np.abs(directions)
    reach = np.abs(directions @ generators).sum(axis=-1)
    scale = rounding + np.abs(generators).sum(axis=-1)
    margin = 2 * (n + g + 4) * EPS * (size @ scale[..., None])[..., 0] + np.finfo(np.float64).tiny
    return np.asarray(np.abs((directions @ shift[..., None])[..., 0]) > reach + margin)


def _separating(shift: FloatArray, generators: FloatArray) -> FloatArray:
    """A direction (n,) of greatest ``d·shift - Σ|d·g|`` over ``|d_i| <= 1 / width_i``; zero where there is none."""
    n, g = generators.shape
    width = np.abs(generators).sum(axis=1) + np.abs(shift)
    width = np.where(width > 0, width, 1.0)
    columns = (generators / width[:, None]).T
    solution = linprog(
        np.concatenate([-shift / width, np.ones(g)]),
        A_ub=np.block([[columns, -np.eye(g)], [-columns, -np.eye(g)]]),
        b_ub=np.zeros(2 * g),
        bounds=[(-1, 1)] * n + [(0, None)] * g,
        method="highs",
    )
    if solution.status != 0 or solution.x is None:
        return np.zeros(n)
    return np.asarray(solution.x[:n] / width)


def constrained_contains(outer: Parts, inner: Parts) -> BoolArray:
    """True (...) where ``inner`` certainly lies in ``outer``, up to 1e-7 of its size, the rounding of the centers and
    1e-12 of the generators of ``inner``; False: not shown. An empty ``inner`` lies in all.

    In the plane the outlines decide, and in one dimension the intervals; beyond, a linear program for each pair.
    """
    batch = batch_of(outer, inner)
    empty = support.certainly_empty(inner)
    far = np.abs(outer[0]) + np.abs(inner[0])
    if outer[0].shape[-1] == 1:
        reach, inner_reach = (np.abs(parts[1]).sum(axis=-1) for parts in (outer, inner))
        slack = PROGRAM_SLACK * reach + 4 * EPS * far
        slack = slack + outline.ROUNDING * inner_reach
        low, high = support.interval_hull(outer)
        inner_low, inner_high = support.interval_hull(inner)
        inside = ((low <= inner_low + slack) & (inner_high <= high + slack)).all(axis=-1)
        return np.broadcast_to(inside & ~support.certainly_empty(outer) | empty, batch)
    if outer[0].shape[-1] == 2:
        mine, theirs = outline.outline(*outer), outline.outline(*inner)
        size, inner_size = (np.abs(parts[1]).sum(axis=(-2, -1)) for parts in (outer, inner))
        size = size + (8 * EPS * far.sum(axis=-1) + outline.ROUNDING * inner_size) / PROGRAM_SLACK
        inside = _polygon_contains(mine.normals, mine.heights, size, theirs.outer)
        return np.broadcast_to((inside & mine.exact & ~mine.empty) | empty, batch)
    outer, inner = common_batch(outer, batch), common_batch(inner, batch)
    found = np.array(np.broadcast_to(empty, batch))
    for index in np.argwhere(~found):
        found[tuple(index)] = _contains(at(outer, tuple(index)), at(inner, tuple(index)))
    return found


def _polygon_contains(normals: FloatArray, heights: FloatArray, size: FloatArray, vertices: FloatArray) -> BoolArray:
    """True (...) where all ``vertices`` (..., V, 2) keep ``normals`` (..., K, 2) below ``heights`` (..., K), up to 1e-7
    of ``size`` (...)."""
    reach = (vertices @ np.swapaxes(normals, -1, -2)).max(axis=-2)
    return np.asarray((reach <= heights + PROGRAM_SLACK * size[..., None]).all(axis=-1))


def _contains(outer: Parts, inner: Parts) -> bool:
    """True where the set ``inner`` certainly lies in ``outer``, up to 1e-7 of its size; False: not shown.

    Sufficient: an affine map of the inner set's factors, ``β = γ + Γξ``, that meets ``c + Gβ = c' + G'ξ`` and ``Aβ =
    b`` wherever ``A'ξ = b'`` (so up to multiples of those rows), with ``|γ| + |Γ| 1 <= 1``. For zonotopes this is
    [ST19], theorem 3; one linear program.
    """
    center, generators, matrix, offset = outer
    inner_center, inner_generators, inner_matrix, inner_offset = inner
    if not inner_generators.any():
        # A point, if it is anything.
        return bool(membership.reach(*outer, inner_center)[0])
    size = np.abs(generators).sum(axis=1)
    rounding = 4 * EPS * (np.abs(center) + np.abs(inner_center))
    # Far away, the centers are rounded by more than the solver's accuracy: the set is enlarged by a box of that.
    far = rounding > PROGRAM_SLACK * size
    blur = (np.where(far, rounding, 0.0) * np.eye(len(center)))[:, far]
    generators = np.concatenate([generators, blur], axis=1)
    matrix = np.concatenate([matrix, np.zeros((len(matrix), blur.shape[1]))], axis=1)
    g, k = generators.shape[1], inner_generators.shape[1]
    stacked = np.concatenate([generators, matrix])
    columns = np.concatenate([inner_generators, np.zeros((len(matrix), k))])
    shift = np.concatenate([inner_center - center, offset])
    size = np.abs(stacked).sum(axis=1)
    # Where the outer set has no size, what the other one has there is all that counts.
    size = np.where(size > 0, size, np.abs(columns).sum(axis=1) + np.abs(shift))
    size = np.where(size > 0, size, 1.0)
    stacked, columns, shift = stacked / size[:, None], columns / size[:, None], shift / size
    inner_matrix, inner_offset = support.unit_rows(inner_matrix, inner_offset)
    rows, inner_rows = len(stacked), len(inner_matrix)
    if not g:
        return False
    # Unknowns: Γ and γ as differences of nonnegative ones (column by column), multiples of the inner rows, the row sum.
    table = np.column_stack([inner_matrix, -inner_offset[:, None]])
    maps = kron(csr_array(stacked), eye_array(k + 1))
    equations: list[Any] = [maps, -maps]
    if inner_rows:
        equations.append(-kron(eye_array(rows), csr_array(table.T)))
    sums = kron(eye_array(g), csr_array(np.ones((1, k + 1))))
    inequalities: list[Any] = [sums, sums]
    if inner_rows:
        inequalities.append(csr_array((g, rows * inner_rows)))
    wide = 2 * g * (k + 1)
    upper: Any = block_array([[*inequalities, csr_array(-np.ones((g, 1)))]])
    equal: Any = block_array([[*equations, csr_array((rows * (k + 1), 1))]])
    bounds: list[tuple[float | None, float | None]] = [(0, None)] * wide
    bounds += [*[(None, None)] * (rows * inner_rows), (0, None)]
    solution = linprog(
        np.append(np.zeros(wide + rows * inner_rows), 1.0),
        A_ub=upper,
        b_ub=np.zeros(g),
        A_eq=equal,
        b_eq=np.column_stack([columns, shift]).ravel(),
        bounds=bounds,
        method="highs",
    )
    return bool(solution.status == 0 and solution.fun is not None and solution.fun <= 1 + PROGRAM_SLACK)
