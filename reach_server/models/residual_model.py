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

Rounding of a residual, a sum of p + 2 terms, is at most ``(p + 2) EPS`` times their sizes, the largest of which over
the data, with some more for the turning of targets, is added to the box of N.

The bound on e between the data: ``|e_i(ξ) - e_i(ξ')| <= Σ_c L_ic |ξ_c - ξ'_c|``, L from the profile.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Lipschitz, VehicleProfile
from reach_server.data.regressors import RegressorSpec, Transitions
from reach_server.models.set_membership import Fitted, residual_sets
from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import FloatArray

#: Directions beside the axes in which residuals are bounded, of a class whose noise set is not a box.
MOST_DIRECTIONS = 4
#: The noise set counts as thin in a direction if its width there is less than this part of that of its box.
THIN = 0.8
#: The data determines a model if the least eigenvalue of its correlations is more than this part of the greatest.
FULL_RANK = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class NoiseBounds:
    """Generators of the noise: ``process`` (n, g) in the frame of the model, ``measurement`` (n, h)."""

    process: FloatArray
    measurement: FloatArray

    @classmethod
    def of(cls, profile: VehicleProfile, layout: RegressorSpec) -> "NoiseBounds":
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
    """Models of V vehicles of a class, with what bounds their residual functions. Arrays are contiguous.

    Attributes:
        matrix: M (V, n, 1 + p).
        z: regressors of data that bound the residual function (V, p, B).
        residual: their residuals (V, n, B).
        held: how many data (V,) there are, the first ones.
        low, high: hull of the residuals of all data (V, n), of those held at least.
        noise: generators of N (V, n, n + g), the first n a box.
        slope: L of the residual function (V, n, p); zero where the profile states none.
        z_noise: half-widths (V, p) of the error of the regressors.
        directions: (V, K, n) beside the axes in which residuals are bounded; zero where there are fewer.
        rank_deficient: (V,) the data did not determine M (the least-norm solution was taken).
        newest: state (V, n) of the newest sample; a model in which an angle is a regressor holds in its turn.
    """

    matrix: FloatArray
    z: FloatArray
    residual: FloatArray
    held: NDArray[np.int64]
    low: FloatArray
    high: FloatArray
    noise: FloatArray
    slope: FloatArray
    z_noise: FloatArray
    directions: FloatArray
    rank_deficient: NDArray[np.bool_]
    newest: FloatArray

    def arrays(self) -> Fitted:
        """The arrays in the form that kernels take."""
        return Fitted(*(getattr(self, name) for name in Fitted._fields))


def least_squares(data: Transitions) -> tuple[FloatArray, NDArray[np.bool_]]:
    """M (V, n, 1 + p) of least squared residual, and where the data does not determine it (V,)."""
    weight = data.usable[..., None].astype(np.float64)
    count = np.maximum(weight.sum(axis=1), 1.0)
    z_mean, y_mean = ((a * weight).sum(axis=1) / count for a in (data.z, data.target))
    z = (data.z - z_mean[:, None]) * weight
    y = (data.target - y_mean[:, None]) * weight
    across = np.swapaxes(z, 1, 2)
    return solve(across @ z / count[..., None], across @ y / count[..., None], z_mean, y_mean)


def solve(
    covariance: FloatArray, cross: FloatArray, z_mean: FloatArray, y_mean: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """M (V, n, 1 + p) from covariances of the regressors (V, p, p) and of these with the targets (V, p, n), and where
    they do not determine it (V,): there the solution of least norm.

    Regressors are scaled first, so that rank test and least-norm solution do not depend on units or on where the
    vehicle stands.
    """
    scale = np.sqrt(np.maximum(np.einsum("vcc->vc", covariance), 0.0))
    varies = scale > 1e-12 * (1.0 + np.abs(z_mean))
    inverse = np.where(varies, 1.0 / np.where(varies, scale, 1.0), 0.0)
    correlation = covariance * inverse[:, :, None] * inverse[:, None, :]
    values, vectors = np.linalg.eigh(correlation)
    retained = values > FULL_RANK * np.maximum(values[:, -1:], 1e-300)
    spectrum = np.where(retained, 1.0 / np.where(retained, values, 1.0), 0.0)
    scaled = (vectors * spectrum[:, None, :]) @ (np.swapaxes(vectors, 1, 2) @ (cross * inverse[:, :, None]))
    slopes = np.swapaxes(scaled * inverse[:, :, None], 1, 2)
    constant = y_mean - (slopes @ z_mean[..., None])[..., 0]
    return np.concatenate([constant[..., None], slopes], axis=-1), ~retained.all(axis=1)


def apply(matrix: FloatArray, z: FloatArray) -> FloatArray:
    """``M [1; z]`` for M (V, n, 1 + p) and z (V, T, p): (V, T, n)."""
    return matrix[:, None, :, 0] + z @ np.swapaxes(matrix[..., 1:], 1, 2)


def fit(data: Transitions, layout: RegressorSpec, bounds: NoiseBounds, lipschitz: Lipschitz | None) -> Model:
    """Least-squares models of V vehicles, bounded by all of their data. Every vehicle needs a usable transition at
    least. Any matrix is sound (mathematics, 2.2); the bounds are outer if those that are given hold."""
    matrix, deficient = least_squares(data)
    residual = data.target - apply(matrix, data.z)
    usable = data.usable[..., None]
    low = np.where(usable, residual, np.inf).min(axis=1)
    high = np.where(usable, residual, -np.inf).max(axis=1)
    largest = np.where(usable, np.abs(np.concatenate([data.z, data.target], axis=2)), 0.0).max(axis=1)
    noise = noise_set(matrix, largest, layout, bounds)
    order = np.argsort(~data.usable, axis=1, kind="stable")[..., None]
    by_data = [
        np.ascontiguousarray(np.swapaxes(np.take_along_axis(np.where(usable, a, 0.0), order, axis=1), 1, 2))
        for a in (data.z, residual)
    ]
    return Model(
        np.ascontiguousarray(matrix), by_data[0], by_data[1], data.usable.sum(axis=1), low, high, noise,
        residual_slope(matrix, lipschitz), regressor_noise(layout, bounds, len(matrix)),
        thin_directions(noise), deficient, data.newest,
    )  # fmt: skip


def regressor_noise(layout: RegressorSpec, bounds: NoiseBounds, vehicles: int) -> FloatArray:
    """Half-widths (V, p) of the error of the regressors: that of the states among them."""
    half = np.abs(bounds.measurement).sum(axis=1)
    one = np.concatenate([half[list(layout.free)], np.zeros((layout.lags + 1) * layout.m)])
    return np.repeat(one[None], vehicles, axis=0)


def noise_set(matrix: FloatArray, largest: FloatArray, layout: RegressorSpec, bounds: NoiseBounds) -> FloatArray:
    """Generators (V, n, n + g) of N, the first n a box: outer (mathematics, 2.3 and 2.4), rounding of the residuals
    included.

    ``matrix`` (V, n, 1 + p) are the models, ``largest`` (V, p + n) the greatest magnitudes of regressors and targets
    among the data.
    """
    vehicles, n, columns = matrix.shape
    other = bounds.measurement
    box = np.abs(matrix[..., 1:]) @ largest[:, : columns - 1, None] + np.abs(matrix[..., :1])
    box = (columns + 10) * EPS * (box[..., 0] + largest[:, columns - 1 :])
    if layout.pose is not None:
        other = bounds.measurement.copy()
        other[list(layout.pose[:2])] = 0.0
        box[:, layout.pose[:2]] += position_error(largest[:, columns - 1 :], layout, bounds)
    # (E + A) Z_v, E for the body frame only: columns that the model does not see are the same for all vehicles.
    free = bounds.measurement[list(layout.free)]
    seen = free.any(axis=0)
    twice = other if layout.pose is not None else np.zeros_like(other)
    through_model = matrix[..., 1 : 1 + len(layout.free)] @ free[:, seen] + twice[:, seen]
    common = np.concatenate([bounds.process, other, twice[:, ~seen]], axis=1)
    # Columns along an axis only add to the box.
    along = np.count_nonzero(common, axis=0) <= 1
    box = box + np.abs(common[:, along]).sum(axis=1)
    slanted = np.broadcast_to(common[:, ~along], (vehicles, n, int((~along).sum())))
    return np.concatenate([box[..., None] * np.eye(n), slanted, through_model], axis=-1)


def position_error(seen: FloatArray, layout: RegressorSpec, bounds: NoiseBounds) -> FloatArray:
    """Half-widths (V, 2): error of the measured body-frame increment in position; ``seen`` (V, n) are the greatest
    magnitudes of measured increments."""
    assert layout.pose is not None
    first, second, heading = layout.pose
    half = np.abs(bounds.measurement).sum(axis=1)
    two_points = 2.0 * np.hypot(half[first], half[second])
    turn = half[heading]
    seen = seen[:, [first, second]]
    # The true increment is within the measured one plus the noise of two positions and one turn.
    longest = np.hypot(seen[:, 0], seen[:, 1]) + two_points
    reach = np.minimum(seen + (two_points + turn * longest)[:, None], longest[:, None])
    return np.asarray(two_points + 0.5 * turn**2 * reach + turn * reach[:, ::-1])


def thin_directions(noise: FloatArray) -> FloatArray:
    """Directions (V, K, n) in which N, of generators ``noise`` (V, n, n + g), is thinner than its box, thinnest first;
    zero where there are no more.

    N is thin across its long generators: candidates are, for each generator and each pair of coordinates, the direction
    in that plane that is orthogonal to it; and the diagonals of a planar N. K is 0 if N is a box for the whole class.
    """
    vehicles, n, columns = noise.shape
    if n in (1, columns):
        return np.zeros((vehicles, 0, n))
    half = np.abs(noise).sum(axis=2)
    # Where the box makes up enough of N in all coordinates, it does in all directions.
    thin = (np.einsum("vii->vi", noise[..., :n]) < THIN * half).any(axis=1)
    found = np.zeros((vehicles, MOST_DIRECTIONS, n))
    if thin.any():
        found[thin] = _thinnest(noise[thin], half[thin])
    return found


def _thinnest(noise: FloatArray, half: FloatArray) -> FloatArray:
    """See ``thin_directions``; ``half`` (V, n) are the half-widths of N."""
    vehicles, n, columns = noise.shape
    pairs = np.array(list(combinations(range(n), 2)))
    candidates = np.zeros((vehicles, columns - n, len(pairs), n))
    each = np.arange(len(pairs))
    slanted = np.swapaxes(noise[..., n:], 1, 2)
    candidates[..., each, pairs[:, 0]] = slanted[..., pairs[:, 1]]
    candidates[..., each, pairs[:, 1]] = -slanted[..., pairs[:, 0]]
    candidates = candidates.reshape(vehicles, (columns - n) * len(pairs), n)
    if n == 2:
        diagonal = half[:, None, ::-1] * np.array([[1.0, 1.0], [1.0, -1.0]])
        candidates = np.concatenate([candidates, diagonal], axis=1)
    box = np.abs(candidates) @ half[..., None]
    candidates = candidates / np.where(box > 0, box, 1.0)
    width = np.abs(candidates @ noise).sum(axis=2)
    width[box[..., 0] <= 0] = np.inf
    scaled = candidates * half[:, None]
    lengths = np.linalg.norm(scaled, axis=2)
    found = np.zeros((vehicles, MOST_DIRECTIONS, n))
    each = np.arange(vehicles)
    for k in range(MOST_DIRECTIONS):
        best = np.argmin(width, axis=1)
        thin = width[each, best] < THIN
        if not thin.any():
            break
        found[thin, k] = candidates[each, best][thin]
        alike = np.abs(scaled @ scaled[each, best][..., None])[..., 0]
        width[alike > 0.999 * lengths * lengths[each, best][:, None]] = np.inf
    return found


def residual_slope(matrix: FloatArray, lipschitz: Lipschitz | None) -> FloatArray:
    """L of the residual function (V, n, p) of the models ``matrix`` (V, n, 1 + p): how fast dynamics and model can
    drift apart, per regressor. Outer if ``lipschitz`` is true (mathematics, 2.8); zero without it."""
    slopes = matrix[..., 1:]
    if lipschitz is None:
        return np.zeros(slopes.shape)
    if lipschitz.matrix is not None:
        bound = np.abs(np.array(lipschitz.matrix))
        return np.asarray(bound + (0.0 if lipschitz.of == "residual" else 1.0) * np.abs(slopes))
    lower, upper = np.array(lipschitz.lower), np.array(lipschitz.upper)
    return np.maximum(np.abs(lower - slopes), np.abs(upper - slopes))


@dataclass(frozen=True, slots=True, eq=False)
class ResidualSet:
    """A zonotope that holds e on a set of regressors: ``center`` (V, n), ``generators`` (V, n, g).

    ``contradicted`` (V,): the data excludes every value of e, so a stated bound is wrong; the hull was taken.
    """

    center: FloatArray
    generators: FloatArray
    contradicted: NDArray[np.bool_]


def residual_set(
    model: Model, center: FloatArray, half: FloatArray, *, membership: bool, plane: tuple[int, int] | None = None
) -> ResidualSet:
    """Outer bound of e on the boxes of regressors with ``center`` (V, p) and half-widths ``half`` (V, p): the residual
    hull (mathematics, 2.5; Algorithm 1 of [AJS+22], corrected), or with ``membership`` what set membership leaves of it
    (2.6) [MN04]; sizes are compared by the area in the ``plane`` where one is named."""
    first, second = plane or ((0, 1) if model.low.shape[1] == 2 else (-1, -1))
    return ResidualSet(
        *residual_sets(
            model.arrays(), np.ascontiguousarray(center), np.ascontiguousarray(half), membership, first, second
        )
    )
