"""Tangents of a predicate ``h >= 0`` with concave h.

On a box on which h is concave every tangent bounds it, ``h(x) <= h(p) + J(p)(x - p)`` for p and x of the box, so that
many can be stacked; those at points with ``h(p) = 0`` are the tightest. Where the greatest eigenvalue of the Hessian is
at most a small λ > 0 (an eigenvalue of 0 is known up to rounding only), ``½ λ |x - p|²`` is added.

Where the points lie decides only how tight the tangents are: they are found in plain arithmetic, on rays from a point
of the inside. Along a ray ``h`` is near a parabola, whose root is one Newton step from the border.
"""

import numpy as np

from reach_server.numeric.rounding import EPS, add_down, add_up
from reach_server.numeric.types import FloatArray
from reach_server.predicates.expansion import Expansion
from reach_server.predicates.interval_ad.arithmetic import Bounds
from reach_server.predicates.interval_ad.enclosure import PredicateFunction
from reach_server.predicates.interval_ad.linear_range import dot, product
from reach_server.predicates.remainders import middle, upper_dot

#: Tangents at most.
MOST_TANGENTS = 16
#: Sweeps over the coordinates in search of the greatest value of a parabola on a box.
_SWEEPS = 8


def directions(dimension: int) -> FloatArray:
    """Unit vectors (K, s), opposite ones half of them apart: both ways in one dimension, a regular polygon in the
    plane, axes and corners of a box beyond."""
    if dimension == 1:
        return np.array([[1.0], [-1.0]])
    if dimension == 2:
        angle = 2 * np.pi * np.arange(MOST_TANGENTS) / MOST_TANGENTS
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)
    corners = max(MOST_TANGENTS // 2 - dimension, 0)
    signs = 1.0 - 2.0 * ((np.arange(corners)[:, None] >> np.arange(dimension)) & 1)
    half = np.concatenate([np.eye(dimension), signs / np.sqrt(dimension)])
    return np.concatenate([half, -half])


def tangents(
    function: PredicateFunction,
    points: FloatArray,
    given: Bounds,
    center: FloatArray,
    half: FloatArray,
    curvature: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Half-spaces ``normal·x >= bound`` (R, K, s), (R, K) that hold for all x of boxes with ``h(x) >= 0``: outer.

    points (R, K, s) lie in the boxes ``center ± half`` (R, s), on which no eigenvalue of the Hessian is greater than
    ``curvature`` (R,). The bound is -inf where the tangent is not bounded.
    """
    rows, count, s = points.shape
    repeated = np.repeat(given[0], count, axis=1), np.repeat(given[1], count, axis=1)
    flat = points.reshape(-1, s)
    enclosure = function.enclosure(flat, flat, repeated, curved=False)
    value = enclosure.value[1].reshape(rows, count)
    normal, uncertain = (part.reshape(rows, count, s) for part in middle(enclosure.gradient))
    # From the point to any x of the box.
    far = add_up(half[:, None], (1.0 + 4 * EPS) * np.abs(points - center[:, None]))
    bent = product(0.5 * np.maximum(curvature, 0.0)[:, None], upper_dot(far, far))[1]
    top = add_up(add_up(value, upper_dot(uncertain, far)), bent)
    bound = add_down(dot(normal, points)[0], -top)
    return normal, np.where(np.isfinite(bound), bound, -np.inf)


def border(function: PredicateFunction, expansion: Expansion, given: Bounds) -> FloatArray:
    """Points (R, K, s) of the boxes near ``h = 0``, as far apart as their directions allow."""
    value, _ = middle(expansion.point.value)
    gradient, _ = middle(expansion.point.gradient)
    hessian, bend = middle(expansion.box.hessian)
    half = expansion.half
    inside = _highest(gradient, hessian, half)
    height, slope = _parabola(value, gradient, hessian, inside)
    rays = _rays(hessian, np.maximum(height, 0.0), half)
    first = _reached(inside, rays, half, height, slope, hessian)
    if not bend.any():
        return np.clip(expansion.center[:, None] + first, expansion.lower[:, None], expansion.upper[:, None])
    return _refined(function, expansion, given, inside, rays, first)


def _highest(gradient: FloatArray, hessian: FloatArray, half: FloatArray) -> FloatArray:
    """About where (R, s) the parabola ``gradient·d + ½ dᵀ hessian d`` is greatest for ``|d| <= half``."""
    d = np.zeros_like(half)
    for _ in range(_SWEEPS):
        for i in range(half.shape[1]):
            slope = gradient[:, i] + (hessian[:, i] * d).sum(axis=1) - hessian[:, i, i] * d[:, i]
            bend = hessian[:, i, i]
            with np.errstate(all="ignore"):
                best = np.where(bend < 0, -slope / bend, np.sign(slope) * half[:, i])
            d[:, i] = np.clip(np.nan_to_num(best), -half[:, i], half[:, i])
    return d


def _parabola(
    value: FloatArray, gradient: FloatArray, hessian: FloatArray, d: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Height (R,) and slope (R, s) of a parabola at d."""
    bent = (hessian @ d[..., None])[..., 0]
    return value + (gradient * d).sum(axis=1) + 0.5 * (bent * d).sum(axis=1), gradient + bent


def _rays(hessian: FloatArray, height: FloatArray, half: FloatArray) -> FloatArray:
    """Directions (R, K, s), spread evenly over an ellipsoid like the part of the box in which ``h >= 0``."""
    with np.errstate(all="ignore"):
        like = -hessian / (2 * height)[:, None, None]
        scale = np.where(half > 0, half, 1.0)
        # In units of the box, so that the decomposition is of numbers of about the size of one.
        shape = np.eye(half.shape[1]) + scale[:, :, None] * scale[:, None, :] * like
    shape = np.where(np.isfinite(shape).all(axis=(1, 2), keepdims=True), shape, np.eye(half.shape[1]))
    values, vectors = np.linalg.eigh(shape)
    root = vectors / np.sqrt(np.maximum(values, 1e-12))[:, None, :]
    found = np.einsum("rij,kj->rki", root @ np.swapaxes(vectors, 1, 2), directions(half.shape[1]))
    return np.asarray(found * half[:, None])


def _reached(
    inside: FloatArray, rays: FloatArray, half: FloatArray, height: FloatArray, slope: FloatArray, hessian: FloatArray
) -> FloatArray:
    """Where (R, K, s) the parabola comes to 0 on rays from ``inside``, or the box ends."""
    along = (rays * slope[:, None]).sum(axis=2)
    bend = 0.5 * np.einsum("rki,rij,rkj->rk", rays, hessian, rays)
    with np.errstate(all="ignore"):
        # The positive root of height + along ρ + bend ρ²; height is not negative where it matters.
        discriminant = np.sqrt(np.maximum(along**2 - 4 * bend * height[:, None], 0.0))
        root = 2 * height[:, None] / np.where(discriminant - along > 0, discriminant - along, np.nan)
    return inside[:, None] + _stopped(root, inside, rays, half)[..., None] * rays


def _stopped(root: FloatArray, inside: FloatArray, rays: FloatArray, half: FloatArray) -> FloatArray:
    """``root`` (R, K), but not beyond the box; its end where there is none."""
    with np.errstate(all="ignore"):
        ends = (np.copysign(half[:, None], rays) - inside[:, None]) / rays
    end = np.where(rays == 0, np.inf, ends).min(axis=2)
    end = np.where(np.isfinite(end), np.maximum(end, 0.0), 0.0)
    return np.where(root >= 0, np.minimum(root, end), end)


def _refined(
    function: PredicateFunction,
    expansion: Expansion,
    given: Bounds,
    inside: FloatArray,
    rays: FloatArray,
    first: FloatArray,
) -> FloatArray:
    """Points one Newton step further along their rays."""
    rows, count, s = first.shape
    center, lower, upper = (a[:, None] for a in (expansion.center, expansion.lower, expansion.upper))
    flat = np.clip(center + first, lower, upper).reshape(-1, s)
    repeated = np.repeat(given[0], count, axis=1), np.repeat(given[1], count, axis=1)
    enclosure = function.enclosure(flat, flat, repeated, curved=False)
    value = middle(enclosure.value)[0].reshape(rows, count)
    along = (middle(enclosure.gradient)[0].reshape(rows, count, s) * rays).sum(axis=2)
    size = (rays**2).sum(axis=2)
    with np.errstate(all="ignore"):
        at = ((first - inside[:, None]) * rays).sum(axis=2) / size
        moved = np.where(along < 0, at - value / along, at)
    moved = np.where(np.isfinite(moved), moved, 0.0)
    step = _stopped(np.maximum(moved, 0.0), inside, rays, expansion.half)
    return np.clip(center + inside[:, None] + step[..., None] * rays, lower, upper)
