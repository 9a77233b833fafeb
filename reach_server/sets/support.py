"""Support functions: exact for zonotopes, certified from above for constrained zonotopes."""

import numpy as np

from reach_server.sets.arrays import Array


def zonotope_support(center: Array, generators: Array, directions: Array) -> Array:
    """Greatest ``d·x`` over the zonotope for directions (..., K, n): exact, shape (..., K)."""
    projected = directions @ generators
    return np.asarray((directions @ center[..., None])[..., 0] + np.abs(projected).sum(axis=-1))


def constrained_support(
    center: Array, generators: Array, matrix: Array, offset: Array, directions: Array, iterations: int = 16
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
    wide_matrix = np.broadcast_to(matrix[..., None, :, :], (*batch, count, rows, g)).reshape(-1, rows, g)
    wide_offset = np.broadcast_to(offset[..., None, :], (*batch, count, rows)).reshape(-1, rows)
    wide_costs = np.broadcast_to(costs, (*batch, count, g)).reshape(-1, g)
    best = minimise_dual(wide_costs, wide_matrix, wide_offset, iterations)
    return np.asarray(linear + best.reshape(*batch, count))


def emptiness_certificate(matrix: Array, offset: Array, iterations: int = 16) -> Array:
    """True (...) where some y has ``b·y + |Aᵀy|₁ < 0``: no ``|β| <= 1`` solves ``Aβ = b`` (Farkas), so empty.

    One-sided: False says that no certificate was found, not that the set is inhabited.
    """
    rows, g = matrix.shape[-2:]
    batch = np.broadcast_shapes(matrix.shape[:-2], offset.shape[:-1])
    if rows == 0:
        return np.zeros(batch, dtype=bool)
    flat_matrix = np.broadcast_to(matrix, (*batch, rows, g)).reshape(-1, rows, g)
    flat_offset = np.broadcast_to(offset, (*batch, rows)).reshape(-1, rows)
    value = minimise_dual(np.zeros((len(flat_matrix), g)), flat_matrix, flat_offset, iterations)
    # Rounding of a sum of g + rows terms must not look like a certificate.
    scale = np.abs(flat_matrix).sum(axis=(-2, -1)) + np.abs(flat_offset).sum(axis=-1)
    return np.asarray(value < -1e-9 * (1.0 + scale)).reshape(batch)


def minimise_dual(costs: Array, matrix: Array, offset: Array, iterations: int) -> Array:
    """Least value found (P,) of ``b·y + |g - Aᵀy|₁`` over y, for costs (P, g), A (P, c, g), b (P, c).

    Newton's method on the smoothed absolute value ``sqrt(r² + mu²)`` with falling mu; the value returned is
    the unsmoothed one at the best y met, y = 0 included.
    """
    scale = np.abs(matrix).max(axis=-1, keepdims=True)
    scale = np.where(scale > 0, scale, 1.0)
    matrix, offset = matrix / scale, offset / scale[..., 0]
    transposed = np.swapaxes(matrix, -1, -2)
    y = np.zeros_like(offset)
    residual = costs
    best = np.abs(costs).sum(axis=-1)
    mu = 0.3 * np.maximum(np.abs(costs).max(axis=-1, keepdims=True), 1e-3 * np.abs(offset).max(axis=-1, keepdims=True))
    mu = np.maximum(mu, 1e-9)
    ridge = 1e-9 * np.eye(offset.shape[-1])
    for _ in range(iterations):
        smooth = np.sqrt(residual**2 + mu**2)
        gradient = offset - (matrix @ (residual / smooth)[..., None])[..., 0]
        weights = mu**2 / smooth**3
        hessian = (matrix * weights[..., None, :]) @ transposed
        trace = np.trace(hessian, axis1=-2, axis2=-1)[..., None, None]
        step = np.linalg.solve(hessian + ridge * (1.0 + trace), gradient[..., None])[..., 0]
        current = (offset * y).sum(axis=-1) + smooth.sum(axis=-1)
        length = np.ones((len(y), 1))
        for _ in range(6):
            trial = y - length * step
            residual = costs - (transposed @ trial[..., None])[..., 0]
            value = (offset * trial).sum(axis=-1) + np.sqrt(residual**2 + mu**2).sum(axis=-1)
            worse = value > current
            if not worse.any():
                break
            length[worse] *= 0.3
        y = np.where(worse[:, None], y, trial)
        residual = costs - (transposed @ y[..., None])[..., 0]
        best = np.minimum(best, (offset * y).sum(axis=-1) + np.abs(residual).sum(axis=-1))
        mu = mu * 0.4
    return np.asarray(best)
