"""Support functions: exact for zonotopes, certified from above for constrained zonotopes."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from reach_server.numeric.jit import stacked
from reach_server.numeric.types import BoolArray, FloatArray, IntArray
from reach_server.sets.kernels import simplex
from reach_server.sets.parts import Parts, batch_of

#: Iterations of one linear program; a few dozen are used.
ITERATIONS = 2000


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
    """``d·x <= bound`` (..., K) on the whole set, proved by ``weights`` y (..., K, c):
    ``bound = d·c + b·y + |Gᵀd - Aᵀy|₁`` (and what rounding may have taken from these sums).

    On a set that is certainly empty the bound is -inf and the weights are those of ``EmptinessCertificate``.
    """

    bound: FloatArray
    weights: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class EmptinessCertificate:
    """``empty`` (...) where ``weights`` y (..., c) prove it: ``b·y + |Aᵀy|₁ < 0`` (Farkas). Elsewhere they are zero.

    A weight says how much its row takes part in the contradiction; one row more per cut, so it names the cut.
    """

    empty: BoolArray
    weights: FloatArray


class Solution(NamedTuple):
    """Linear programs solved: ``bound`` (..., K), ``weights`` (..., K, c), ``factors`` (..., K, g) of the points that
    attain it, ``ray`` (..., c) and ``status`` (..., K) as in ``reach_server.sets.kernels.simplex``."""

    bound: FloatArray
    weights: FloatArray
    factors: FloatArray
    ray: FloatArray
    status: IntArray

    @property
    def empty(self) -> BoolArray:
        """True (..., K) where the set is certainly empty."""
        return np.asarray(self.status == simplex.EMPTY)


def zonotope_support(center: FloatArray, generators: FloatArray, directions: FloatArray) -> FloatArray:
    """Greatest ``d·x`` over the zonotope for directions (..., K, n): exact, shape (..., K)."""
    projected = directions @ generators
    return np.asarray((directions @ center[..., None])[..., 0] + np.abs(projected).sum(axis=-1))


def solve(
    center: FloatArray,
    generators: FloatArray,
    matrix: FloatArray,
    offset: FloatArray,
    directions: FloatArray,
    iterations: int = ITERATIONS,
) -> Solution:
    """Greatest ``d·x`` over constrained zonotopes for directions (..., K, n), with all that the solver found."""
    batch: tuple[int, ...] = ()
    # One set asked alone is the case where looking at shapes would take as long as the answer.
    if center.ndim + generators.ndim + matrix.ndim + offset.ndim + directions.ndim > 8:
        shapes = (center.shape[:-1], generators.shape[:-2], matrix.shape[:-2], offset.shape[:-1], directions.shape[:-2])
        batch = np.broadcast_shapes(*shapes)
    size = math.prod(batch)
    found = simplex.supports(
        stacked(center, 1, batch, size),
        stacked(generators, 2, batch, size),
        stacked(matrix, 2, batch, size),
        stacked(offset, 1, batch, size),
        stacked(directions, 2, batch, size),
        size,
        iterations,
    )
    if len(batch) == 1:
        return Solution(*found)
    bound, weights, factors, ray, status = found
    if not batch:
        return Solution(bound[0], weights[0], factors[0], ray[0], status[0])
    return Solution(
        bound.reshape(batch + bound.shape[1:]),
        weights.reshape(batch + weights.shape[1:]),
        factors.reshape(batch + factors.shape[1:]),
        ray.reshape(batch + ray.shape[1:]),
        status.reshape(batch + status.shape[1:]),
    )


def constrained_support(
    center: FloatArray,
    generators: FloatArray,
    matrix: FloatArray,
    offset: FloatArray,
    directions: FloatArray,
    iterations: int = ITERATIONS,
) -> FloatArray:
    """Upper bound of ``d·x`` over the constrained zonotope for directions (..., K, n): outer, shape (..., K).

    For every y, ``d·x = d·c + (Gᵀd - Aᵀy)·β + b·y <= d·c + b·y + |Gᵀd - Aᵀy|₁`` on the set, since
    ``Aβ = b`` and ``|β| <= 1``; the best y is exact by linear programming duality. So whatever y the simplex method
    ends with, the value is a bound. Its rounding is added, about ``(c + g) * 2e-16`` of the terms summed, so it is
    never below the true support. Where the set is empty the value is finite and says nothing.
    """
    return solve(center, generators, matrix, offset, directions, iterations).bound


def parts_support(parts: Parts, directions: FloatArray) -> FloatArray:
    """Upper bound (..., K) of ``d·x`` for directions (..., K, n): outer; -inf where the set is certainly empty."""
    found = solve(*parts, directions)
    return np.where(found.empty, -np.inf, found.bound)


def interval_hull(parts: Parts) -> tuple[FloatArray, FloatArray]:
    """Least box around constrained zonotopes, (lower (..., n), upper (..., n)): outer; (inf, -inf) where the set is
    certainly empty."""
    n = parts[1].shape[-2]
    unit = np.eye(n)
    bounds = parts_support(parts, np.concatenate([unit, -unit]))
    lower, upper = -bounds[..., n:], bounds[..., :n]
    # Of a set that only rounding made empty the bounds may cross: the hull of both.
    crossed = (lower > upper) & np.isfinite(lower)
    return np.where(crossed, upper, lower), np.where(crossed, lower, upper)


def feasible(matrix: FloatArray, offset: FloatArray, iterations: int = ITERATIONS) -> Solution:
    """Some vertex of ``{Aβ = b, |β| <= 1}``, or the proof that there is none: ``factors`` (..., 1, g), ``ray``."""
    g = matrix.shape[-1]
    # Costs in no special position to the rows: emptiness shows for any costs, most quickly for these.
    costs = np.cos(np.arange(g) * math.sqrt(2.0))[None]
    return solve(np.zeros(1), costs, matrix, offset, np.ones((1, 1)), iterations)


def farkas(matrix: FloatArray, offset: FloatArray, iterations: int = ITERATIONS) -> EmptinessCertificate:
    """Where no ``|β| <= 1`` solves ``Aβ = b``, with the weights that prove it; see ``emptiness_certificate``."""
    found = feasible(matrix, offset, iterations)
    return EmptinessCertificate(found.empty[..., 0], found.ray)


def emptiness_certificate(matrix: FloatArray, offset: FloatArray, iterations: int = ITERATIONS) -> BoolArray:
    """True (...) where some y has ``b·y + |Aᵀy|₁ < 0``: no ``|β| <= 1`` solves ``Aβ = b`` (Farkas), so empty.

    One-sided: False says that no certificate was found, not that the set is inhabited. The certificate must exceed
    1e-9 of its terms: what rounding in A and b may have made up is no contradiction.
    """
    return farkas(matrix, offset, iterations).empty


def certainly_empty(parts: Parts) -> BoolArray:
    """True (...) where constrained zonotopes are certainly empty; see ``emptiness_certificate``."""
    empty = emptiness_certificate(*parts[2:])
    return np.broadcast_to(empty, batch_of(parts))


def unit_rows(matrix: FloatArray, offset: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``Aβ = b`` with each row divided by its greatest entry."""
    scale = np.abs(matrix).max(axis=-1, keepdims=True, initial=0.0)
    scale = np.where(scale > 0, scale, 1.0)
    return matrix / scale, offset / scale[..., 0]


def warm_up() -> None:
    """Compile the solver now, if that has not been done since it was installed (some ten seconds)."""
    one = np.ones((1, 1))
    constrained_support(np.zeros(1), one, one, np.zeros(1), one)
    emptiness_certificate(one, np.zeros(1))
