"""Least-squares model with bounds of its residual function (mathematics, section 2; the paper's Algorithm 1).

With states ``x_j``, inputs and lagged inputs forming the regressors ``ξ_j``, one step is ``f(ξ) + w``. For any
matrix M the function ``e(ξ) = f(ξ) - M [1; ξ]`` is bounded from data: with measured regressors ``z_j`` and
targets ``y+_j`` the residual is ``r_j = y+_j - M [1; z_j]`` and ``e(ξ_j) ∈ r_j + N``, N a symmetric noise set.

World frame: ``y = x + v``, so ``N = Z_w + Z_v + A Z_v`` with A the columns of M for the states.

Body frame: the regressand is ``(R(-θ)(p+ - p), θ+ - θ, s+ - s)``. Measured, with ``v`` and ``v+`` the errors of
the two samples, its position part is ``R(-v_θ)[d + R(-θ)(v+_p - v_p)]`` (d the true one), off by
``(R(-v_θ) - I) d`` plus a turned vector of length at most ``|v+_p| + |v_p|``. With ``|v_θ| <= η`` and
``|d| <= D`` per component the first is at most ``(η²/2 D_x + η D_y, η D_x + η²/2 D_y)``; D is bounded by the
largest measured increment plus the noise of two positions. Heading and the other states are off by
``v+ - v``, and the regressors by ``v_s``: together ``N = Z_w + box(position part) + Z_v|other + (E + M_s) Z_v``.

The bound on e between the data: ``|e_i(ξ) - e_i(ξ')| <= Σ_c L_ic |ξ_c - ξ'_c|``, L from the profile.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Lipschitz, VehicleProfile
from reach_server.regression import Layout, Transitions
from reach_server.sets.planar import zonotope_area
from reach_server.windows import Floats


@dataclass(frozen=True, slots=True, eq=False)
class NoiseBounds:
    """Generators (n, g) of the process noise (in the frame of the model) and of the measurement noise."""

    process: Floats
    measurement: Floats

    @classmethod
    def of(cls, profile: VehicleProfile, layout: Layout) -> "NoiseBounds":
        """Bounds of a profile; missing ones are taken as zero (the label then claims nothing).

        Process noise stated in the body frame and used in the world frame is boxed over all headings.
        """
        zero = np.zeros((layout.n, 0))
        process = zero if profile.noise.process is None else profile.noise.process.matrix()
        measurement = zero if profile.noise.measurement is None else profile.noise.measurement.matrix()
        if profile.frame == "body" and layout.pose is None and process.size:
            half = np.abs(process).sum(axis=1)
            half[list(profile.position)] = np.hypot(*half[list(profile.position)])
            process = np.diag(half)
        return cls(process, measurement)


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Models of V vehicles of a class, with what bounds their residual functions.

    Attributes:
        matrix: M (V, n, 1 + p).
        z: regressors of the data (V, p, T), the data last so that reductions over it run through memory in order.
        residual: (V, n, T).
        low, high: hull of the residuals (V, n).
        noise: generators of N (V, n, g).
        slope: L of the residual function (V, n, p); zero where the profile states none.
        z_noise: half-widths (V, p) of the error of the regressors.
        rank_deficient: (V,) the data did not determine M (the least-norm solution was taken).
        penalty: (V, 1, T) zero where a datum counts, infinite where the place holds none.
        newest: state (V, n) of the newest sample; a model in which an angle is a regressor holds in its turn.
    """

    matrix: Floats
    z: Floats
    residual: Floats
    low: Floats
    high: Floats
    noise: Floats
    slope: Floats
    z_noise: Floats
    rank_deficient: NDArray[np.bool_]
    penalty: Floats
    newest: Floats


def least_squares(data: Transitions, ridge: float = 0.0) -> tuple[Floats, NDArray[np.bool_]]:
    """M (V, n, 1 + p) of least squared residual, and where the data does not determine it (V,).

    Centred and scaled first, so that the rank test and the least-norm solution do not depend on units or on
    where the vehicle stands.
    """
    weight = data.usable[..., None].astype(np.float64)
    count = np.maximum(weight.sum(axis=1, keepdims=True), 1.0)
    z_mean = (data.z * weight).sum(axis=1, keepdims=True) / count
    y_mean = (data.target * weight).sum(axis=1, keepdims=True) / count
    z = (data.z - z_mean) * weight
    y = (data.target - y_mean) * weight
    scale = np.sqrt((z**2).sum(axis=1, keepdims=True) / count)
    floor = 1e-12 * (1.0 + np.abs(z_mean))
    varies = scale > floor
    z = z / np.where(varies, scale, 1.0) * varies
    gram = np.swapaxes(z, 1, 2) @ z / count
    values, vectors = np.linalg.eigh(gram)
    kept = values > 1e-10 * np.maximum(values[:, -1:], 1e-300)
    inverse = (vectors * np.where(kept, 1.0 / np.where(kept, values + ridge, 1.0), 0.0)[:, None, :]) @ np.swapaxes(
        vectors, 1, 2
    )
    slopes = np.swapaxes(inverse @ (np.swapaxes(z, 1, 2) @ y / count), 1, 2) / np.where(varies, scale, 1.0)
    constant = y_mean[:, 0] - (slopes @ z_mean[:, 0, :, None])[..., 0]
    return np.concatenate([constant[..., None], slopes], axis=-1), ~kept.all(axis=1)


def apply(matrix: Floats, z: Floats) -> Floats:
    """``M [1; z]`` for M (V, n, 1 + p) and z (V, T, p): (V, T, n)."""
    return matrix[:, None, :, 0] + z @ np.swapaxes(matrix[..., 1:], 1, 2)


def fit(data: Transitions, layout: Layout, bounds: NoiseBounds, lipschitz: Lipschitz | None) -> Model:
    """Fit and bound the models of V vehicles. Every vehicle needs at least one usable transition."""
    matrix, deficient = least_squares(data)
    residual = data.target - apply(matrix, data.z)
    usable = data.usable[..., None]
    low = np.where(usable, residual, np.inf).min(axis=1)
    high = np.where(usable, residual, -np.inf).max(axis=1)
    half = np.abs(bounds.measurement).sum(axis=1)
    z_noise = np.concatenate([half[list(layout.free)], np.zeros((layout.lags + 1) * layout.m)])
    z_noise = np.broadcast_to(z_noise, (len(matrix), len(z_noise)))
    noise = _noise_set(matrix, data, layout, bounds)
    slope = residual_slope(matrix, lipschitz)
    by_data = [np.ascontiguousarray(np.swapaxes(a, 1, 2)) for a in (data.z, np.where(usable, residual, 0.0))]
    penalty = np.where(data.usable, 0.0, np.inf)[:, None]
    return Model(matrix, by_data[0], by_data[1], low, high, noise, slope, z_noise, deficient, penalty, data.newest)


def _noise_set(matrix: Floats, data: Transitions, layout: Layout, bounds: NoiseBounds) -> Floats:
    """Generators (V, n, g) of N, see the head of this module."""
    vehicles = len(matrix)
    states = matrix[..., 1 : 1 + len(layout.free)]
    through_model = states @ bounds.measurement[list(layout.free)]

    def wide(generators: Floats) -> Floats:
        return np.broadcast_to(generators, (vehicles, *generators.shape))

    if layout.pose is None:
        return np.concatenate([wide(bounds.process), wide(bounds.measurement), through_model], axis=-1)
    other = bounds.measurement.copy()
    other[list(layout.pose[:2])] = 0.0
    position = position_error(data, layout, bounds)
    return np.concatenate([wide(bounds.process), wide(other), through_model + other, position], axis=-1)


def position_error(data: Transitions, layout: Layout, bounds: NoiseBounds) -> Floats:
    """Diagonal generators (V, n, 2): error of the measured body-frame increment in position."""
    assert layout.pose is not None
    first, second, heading = layout.pose
    half = np.abs(bounds.measurement).sum(axis=1)
    two_points = 2.0 * np.hypot(half[first], half[second])
    turn = half[heading]
    seen = np.where(data.usable[..., None], np.abs(data.target[..., [first, second]]), 0.0).max(axis=1)
    # The true increment is within the measured one plus the noise of two positions and one turn.
    longest = np.hypot(seen[:, 0], seen[:, 1]) + two_points
    reach = np.minimum(seen + (two_points + turn * longest)[:, None], longest[:, None])
    generators = np.zeros((len(seen), len(half), 2))
    generators[:, first, 0] = two_points + 0.5 * turn**2 * reach[:, 0] + turn * reach[:, 1]
    generators[:, second, 1] = two_points + turn * reach[:, 0] + 0.5 * turn**2 * reach[:, 1]
    return generators


def residual_slope(matrix: Floats, lipschitz: Lipschitz | None) -> Floats:
    """L of the residual function (V, n, p): how fast dynamics and model can drift apart, per regressor."""
    slopes = matrix[..., 1:]
    if lipschitz is None:
        return np.zeros_like(slopes)
    if lipschitz.matrix is not None:
        bound = np.abs(np.array(lipschitz.matrix))
        return np.broadcast_to(bound, slopes.shape) if lipschitz.of == "residual" else bound + np.abs(slopes)
    lower, upper = np.array(lipschitz.lower), np.array(lipschitz.upper)
    return np.maximum(np.abs(lower - slopes), np.abs(upper - slopes))


@dataclass(frozen=True, slots=True, eq=False)
class ResidualSet:
    """A zonotope that holds e on a set of regressors: ``center`` (V, n), ``generators`` (V, n, g).

    ``contradicted`` (V,): the data excludes every value of e, so a stated bound is wrong; the hull was taken.
    """

    center: Floats
    generators: Floats
    contradicted: NDArray[np.bool_]


def residual_set(model: Model, center: Floats, half: Floats, *, membership: bool) -> ResidualSet:
    """Outer bound of e on the boxes ``center ± half`` (V, p) of regressors.

    ``drift_j = Σ_c L_ic D_jc`` with ``D_jc = |center - z_j|_c + half_c + z_noise_c`` bounds, by component i, how far e
    on the box is from e at datum j; this replaces the covering radius of the paper and needs no covering assumption.

    *Residual hull:* ``e ∈ r_j + N + box(drift_j)`` for each datum, so ``hull + N + box(drift_j)`` for any one j. All
    components must take the same j: with the least drift of each, a correlated N would lose values. The j of least
    drift is taken, measured by the widths of hull and N.

    *Set membership* [MN04, theorem 2] uses all data, by component, where each bound holds on its own:
    ``max_j (r_j - n - drift_j) <= e <= min_j (r_j + n + drift_j)``, n the half-widths of N; the smaller of the two
    sets by volume is returned. Without any bound L it would trust every single datum with the whole set; the hull is
    taken then.
    """
    constant = (model.slope @ (half + model.z_noise)[..., None])[..., 0]
    drift = model.slope @ np.abs(center[..., None] - model.z)
    drift += model.penalty
    noise_half = np.abs(model.noise).sum(axis=-1)
    width = (model.high - model.low) / 2 + noise_half
    widest = width.max(axis=-1, keepdims=True)
    weight = 1.0 / np.where(widest > 0, np.maximum(width, 1e-6 * widest), 1.0)
    nearest = np.argmin(weight[:, None] @ drift, axis=-1)
    allowance = np.take_along_axis(drift, nearest[..., None], axis=-1)[..., 0] + constant
    n = center.shape[0], model.matrix.shape[1]
    identity = np.eye(n[1])
    hull_half = (model.high - model.low) / 2 + allowance
    hull_center = (model.high + model.low) / 2
    hull = np.concatenate([hull_half[..., None] * identity, model.noise], axis=-1)
    nothing = np.zeros(n[0], dtype=bool)
    if not membership:
        return ResidualSet(hull_center, hull, nothing)
    slack = noise_half + constant
    upper = (model.residual + drift).min(axis=-1) + slack
    lower = (model.residual - drift).max(axis=-1) - slack
    contradicted = (lower > upper + 1e-9 * (np.abs(lower) + np.abs(upper))).any(axis=-1)
    lower, upper = np.minimum(lower, upper), np.maximum(lower, upper)
    known = (model.slope > 0).any(axis=(1, 2)) & ~contradicted
    box = ((upper - lower) / 2)[..., None] * identity
    smaller = known & (np.prod(upper - lower, axis=-1) <= _volume(hull))
    generators = np.where(smaller[:, None, None], np.concatenate([box, np.zeros_like(model.noise)], axis=-1), hull)
    return ResidualSet(np.where(smaller[:, None], (upper + lower) / 2, hull_center), generators, contradicted)


def _volume(generators: Floats) -> Floats:
    """Area of planar sets, else the volume of the interval hull (which the box of set membership never exceeds)."""
    if generators.shape[-2] == 2:
        return zonotope_area(generators)
    return np.asarray(np.prod(2 * np.abs(generators).sum(axis=-1), axis=-1))
