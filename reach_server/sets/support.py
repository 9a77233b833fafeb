"""Support functions: exact for zonotopes, certified from above for constrained zonotopes."""

import math

import numpy as np

from reach_server.sets.arrays import Array


def zonotope_support(center: Array, generators: Array, directions: Array) -> Array:
    """Greatest ``d·x`` over the zonotope for directions (..., K, n): exact, shape (..., K)."""
    projected = directions @ generators
    return np.asarray((directions @ center[..., None])[..., 0] + np.abs(projected).sum(axis=-1))


def constrained_support(
    center: Array, generators: Array, matrix: Array, offset: Array, directions: Array, iterations: int = 20
) -> Array:
    """Upper bound of ``d·x`` over the constrained zonotope for directions (..., K, n): outer, shape (..., K).

    For every y, ``d·x = d·c + (Gᵀd - Aᵀy)·β + b·y <= d·c + b·y + |Gᵀd - Aᵀy|₁`` on the set, since
    ``Aβ = b`` and ``|β| <= 1``; the best y is exact by linear programming duality. So whatever y the
    minimisation below ends with, the value is a bound. Where the set is empty the value may fall to any depth.
    """
    linear = (directions @ center[..., None])[..., 0]
    costs = directions @ generators
    if matrix.shape[-2] == 0:
        return np.asarray(linear + np.abs(costs).sum(axis=-1))
    batch = np.broadcast_shapes(matrix.shape[:-2], costs.shape[:-2])
    count = directions.shape[-2]
    rows, g = matrix.shape[-2:]
    problems = math.prod(batch) * count
    wide_matrix = np.broadcast_to(matrix[..., None, :, :], (*batch, count, rows, g)).reshape(problems, rows, g)
    wide_offset = np.broadcast_to(offset[..., None, :], (*batch, count, rows)).reshape(problems, rows)
    wide_costs = np.broadcast_to(costs, (*batch, count, g)).reshape(problems, g)
    best = minimise_dual(wide_costs, wide_matrix, wide_offset, iterations)
    return np.asarray(linear + best.reshape(*batch, count))


def emptiness_certificate(matrix: Array, offset: Array, iterations: int = 20) -> Array:
    """True (...) where some y has ``b·y + |Aᵀy|₁ < 0``: no ``|β| <= 1`` solves ``Aβ = b`` (Farkas), so empty.

    One-sided: False says that no certificate was found, not that the set is inhabited.
    """
    rows, g = matrix.shape[-2:]
    batch = np.broadcast_shapes(matrix.shape[:-2], offset.shape[:-1])
    if rows == 0:
        return np.zeros(batch, dtype=bool)
    problems = math.prod(batch)
    flat_matrix = np.broadcast_to(matrix, (*batch, rows, g)).reshape(problems, rows, g)
    flat_offset = np.broadcast_to(offset, (*batch, rows)).reshape(problems, rows)
    # Rows of size 1, so that a constraint counts alike in every unit.
    flat_matrix, flat_offset = unit_rows(flat_matrix, flat_offset)
    value = minimise_dual(np.zeros((len(flat_matrix), g)), flat_matrix, flat_offset, iterations)
    # Rounding of a sum of g + rows terms must not look like a certificate.
    scale = np.abs(flat_matrix).sum(axis=(-2, -1)) + np.abs(flat_offset).sum(axis=-1)
    return np.asarray(value < -1e-9 * (1.0 + scale)).reshape(batch)


def minimise_dual(costs: Array, matrix: Array, offset: Array, iterations: int) -> Array:
    """Least value found (P,) of ``b·y + |g - Aᵀy|₁`` over y, for costs (P, g), A (P, c, g), b (P, c).

    Newton's method on the smoothed absolute value ``sqrt(r² + mu²)`` with falling mu, and iteratively reweighted
    least squares where that does better; the value returned is the unsmoothed one at the best y met, y = 0 included,
    plus what its sums may have lost by rounding. The problem is homogeneous in (g, y) and is solved for costs of
    size 1.
    """
    matrix, offset = unit_rows(matrix, offset)
    # A power of two: dividing by it and multiplying with it rounds nothing.
    unit = np.ldexp(1.0, np.frexp(np.abs(costs).max(axis=-1, keepdims=True, initial=0.0))[1])
    costs = costs / unit
    transposed = np.swapaxes(matrix, -1, -2)
    entries = np.abs(matrix).sum(axis=-1)
    rounding = np.finfo(np.float64).eps * sum(matrix.shape[-2:])
    y = np.zeros_like(offset)
    residual = costs
    best = np.abs(costs).sum(axis=-1)
    steepest = np.abs(costs).max(axis=-1, keepdims=True, initial=0.0)
    mu = 0.3 * np.maximum(steepest, 1e-3 * np.abs(offset).max(axis=-1, keepdims=True))
    mu = np.maximum(mu, 1e-9)
    for _ in range(iterations):
        smooth = np.sqrt(residual**2 + mu**2)
        gradient = offset - (matrix @ (residual / smooth)[..., None])[..., 0]
        newton = _solve(matrix, mu**2 / smooth**3, gradient)
        # Least squares with weights 1/|r| never ascends; it goes on where Newton's method stalls between kinks.
        weighted = _solve(matrix, 1.0 / smooth, gradient)
        lowest = (offset * y).sum(axis=-1) + smooth.sum(axis=-1)
        start = y
        for step in (newton, 0.3 * newton, 0.09 * newton, weighted, 2.0 * weighted):
            trial = start - step
            distance = costs - (transposed @ trial[..., None])[..., 0]
            value = (offset * trial).sum(axis=-1) + np.sqrt(distance**2 + mu**2).sum(axis=-1)
            better = value < lowest
            lowest = np.where(better, value, lowest)
            y = np.where(better[:, None], trial, y)
        residual = costs - (transposed @ y[..., None])[..., 0]
        terms = np.abs(offset * y).sum(axis=-1) + (entries * np.abs(y)).sum(axis=-1)
        best = np.minimum(best, (offset * y).sum(axis=-1) + np.abs(residual).sum(axis=-1) + rounding * terms)
        mu = mu * 0.5
    return np.asarray(best * unit[:, 0])


def _solve(matrix: Array, weights: Array, gradient: Array) -> Array:
    """Solution (P, c) of ``A diag(w) Aᵀ step = gradient``, regularised: rows may repeat."""
    hessian = (matrix * weights[..., None, :]) @ np.swapaxes(matrix, -1, -2)
    trace = np.trace(hessian, axis1=-2, axis2=-1)[..., None, None]
    ridge = 1e-12 * (1.0 + 1e3 * trace) * np.eye(gradient.shape[-1])
    return np.asarray(np.linalg.solve(hessian + ridge, gradient[..., None])[..., 0])


def unit_rows(matrix: Array, offset: Array) -> tuple[Array, Array]:
    """``Aβ = b`` with each row divided by its greatest entry."""
    scale = np.abs(matrix).max(axis=-1, keepdims=True, initial=0.0)
    scale = np.where(scale > 0, scale, 1.0)
    return matrix / scale, offset / scale[..., 0]
