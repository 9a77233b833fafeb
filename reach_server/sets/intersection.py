"""Intersections of a set with a linear preimage of another, and zonotopes around those with many half-spaces."""

import numpy as np

from reach_server.numeric.checks import stack_columns
from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import FloatArray
from reach_server.sets import halfspace as strips
from reach_server.sets.containment import face_normals
from reach_server.sets.parts import Parts, joined_constraints
from reach_server.sets.precise import product, remainder
from reach_server.sets.redundancy import drop_zero

#: Faces of a planar set that are cut with: those of its longest generators.
FACES = 6


def intersect_halfspaces(
    center: FloatArray, generators: FloatArray, normals: FloatArray, bounds: FloatArray, method: strips.StripMethod
) -> tuple[FloatArray, FloatArray]:
    """Center and generators of a zonotope around the part with ``normals @ x <= bounds`` (..., K, n), (..., K): outer.

    One cut after the other, in the order given; each adds at most one generator (see ``strips.intersect_strip``).
    """
    for k in range(normals.shape[-2]):
        center, generators, _ = strips.intersect_strip(
            center, generators, normals[..., k, :], np.asarray(-np.inf), bounds[..., k], method=method
        )
    return center, generators


def intersect_zonotope(
    center: FloatArray,
    generators: FloatArray,
    matrix: FloatArray,
    other_center: FloatArray,
    other_generators: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Center and generators of a zonotope around ``{x in <c, G> : Rx in <c2, G2>}`` for R (..., k, n): outer.

    For every λ (..., n, k) ``<c + λ(c2 - Rc), [(I - λR)G, λG2]>`` holds the intersection, as for strips [ABC05]: there
    ``x = c + Gβ + λ(Rx - R(c + Gβ))``. Of λ = 0, the weighted Frobenius optima and, where R is the identity, λ = I, the
    smallest result is taken, then cut with strips around both sets (planar: those of the edges of their longest
    generators; else the axes), which never enlarges it.
    """
    n, k = generators.shape[-2], matrix.shape[-2]
    inside = [np.zeros((*generators.shape[:-2], n, k))]
    # λ does not depend on the unit of both sets, their squares may not be numbers: a power of two rounds nothing.
    largest = np.maximum(*(np.abs(g).max(axis=(-2, -1), initial=0.0) for g in (generators, other_generators)))
    power = -np.frexp(largest)[1][..., None, None]
    scaled, other_scaled = np.ldexp(generators, power), np.ldexp(other_generators, power)
    own = scaled @ np.swapaxes(scaled, -1, -2)
    seen = matrix @ own @ np.swapaxes(matrix, -1, -2)
    others = other_scaled @ np.swapaxes(other_scaled, -1, -2)
    for weight in (0.5, 0.1, 0.9):
        system = weight * seen + (1 - weight) * others
        trace = np.trace(system, axis1=-2, axis2=-1)[..., None, None]
        system = system + np.where(trace > 0, 1e-12 * trace, 1.0) * np.eye(k)
        right = weight * matrix @ own
        inside.append(np.swapaxes(np.linalg.solve(system, np.broadcast_to(right, (*system.shape[:-2], k, n))), -1, -2))
    if k == n and np.array_equal(matrix, np.broadcast_to(np.eye(n), matrix.shape)):
        inside.append(np.broadcast_to(np.eye(n), inside[0].shape))
    batch = np.broadcast_shapes(
        center.shape[:-1], other_center.shape[:-1], *(c.shape[:-2] for c in inside), other_generators.shape[:-2]
    )
    options = np.stack([np.broadcast_to(c, (*batch, n, k)) for c in inside], axis=-3)
    kept = generators[..., None, :, :] - options @ product(matrix, generators)[..., None, :, :]
    added = options @ other_generators[..., None, :, :]
    candidates = np.concatenate([kept, added], axis=-1)
    best = np.argmin(strips.log_size(candidates, None), axis=-1)[..., None, None, None]
    chosen = np.take_along_axis(options, best, axis=-3)[..., 0, :, :]
    result = np.take_along_axis(candidates, best, axis=-3)[..., 0, :, :]
    # Far away the difference is small beside its terms, and a λ may carry its rounding into any coordinate.
    shift = remainder(other_center, matrix, center)
    middle = center + (chosen @ shift[..., None])[..., 0]
    for normal, height, reach in [
        *_strips(other_center, other_generators, matrix),
        *_strips(center, generators, np.eye(n)),
    ]:
        middle, result, _ = strips.intersect_strip(middle, result, normal, height - reach, height + reach)
    return middle, drop_zero(result)


def _strips(
    center: FloatArray, generators: FloatArray, matrix: FloatArray
) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Strips (normal (..., n), height (...), reach (...)) of x whose image ``matrix @ x`` lies in the zonotope; each
    reach is rounded outwards."""
    k, g = generators.shape[-2:]
    longest = np.argsort(-(generators**2).sum(axis=-2), axis=-1, kind="stable")[..., None, :FACES]
    normals = face_normals(np.take_along_axis(generators, longest, axis=-1))
    heights = (normals @ center[..., None])[..., 0]
    reach = np.abs(normals @ generators).sum(axis=-1)
    scale = np.abs(center) + np.abs(generators).sum(axis=-1)
    reach = reach + 2 * (k + g + 4) * EPS * (np.abs(normals) @ scale[..., None])[..., 0]
    mapped = normals @ matrix
    return [(mapped[..., j, :], heights[..., j], reach[..., j]) for j in range(normals.shape[-2])]


def intersect_constrained(parts: Parts, other: Parts, matrix: FloatArray | None) -> Parts:
    """The parts of ``{x in <c, G, A, b> : Rx in other}`` for R = ``matrix`` (..., k, n), None: identity; exact
    [SDB+16]."""
    center, generators = parts[:2]
    n = generators.shape[-2]
    joined, offset = joined_constraints(parts, other)
    # Rows that cancel out must vanish: what rounding leaves of them would tie down factors.
    own = generators if matrix is None else product(matrix, generators)
    heights = stack_columns(own, -other[1])
    right = remainder(other[0], np.eye(n) if matrix is None else matrix, center)
    batch = np.broadcast_shapes(joined.shape[:-2], offset.shape[:-1], heights.shape[:-2], right.shape[:-1])
    rows = [np.broadcast_to(a, batch + a.shape[-2:]) for a in (joined, heights)]
    offsets = [np.broadcast_to(a, batch + a.shape[-1:]) for a in (offset, right)]
    generators = stack_columns(generators, np.zeros((n, other[1].shape[-1])))
    return center, generators, np.concatenate(rows, axis=-2), np.concatenate(offsets, axis=-1)
