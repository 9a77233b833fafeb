"""Calibrated sets: a ridge regression per horizon step, and boxes whose size is a rank statistic of its own errors.

What is claimed: if the errors to come are exchangeable with those in the window, a set of step h holds the next
measured state with probability at least the profile's ``confidence`` [VGS05, section 2.2]. The errors are
out-of-fold, so no datum judges a model that has seen it; the folds are contiguous, since neighbours in time are alike.

For the current sample k with features ``φ_h`` (constant, free states, two lagged increments, lagged inputs, products
with speed, and the later inputs up to step h where these are known):

    d_{k+h} ≈ M_h φ_h                                  increment in the vehicle's own frame (or the world's)
    θ_{h+1} = θ_h + d^θ ,  p_{h+1} = p_h + R(θ_h) d^p     centre of step h + 1
    E_h = (R(-θ_k)(p_{k+h} - p̂_h), rest)               error in the frame of sample k
    ζ_h = max_i |E_ih| / σ_ih                          σ_ih the confidence quantile of |E_ih|
    s_h = the ceil((W+1) confidence)-th smallest of the W scores ζ_h
    set: p̂_h ± R(θ_k) diag(s_h σ_h)
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import VehicleProfile
from reach_server.factor_sets import FactorSet
from reach_server.regression import (
    Layout,
    increments,
    inputs_known,
    lagged_inputs,
    rotate,
    runs,
    unwrapped,
    wrap,
)
from reach_server.windows import Block, Floats

FOLDS = 5
RIDGE = 1e-4
#: Increments of earlier samples that enter the features.
LAGGED_INCREMENTS = 2


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """Models of V vehicles: ``matrix`` (V, N, n, F) for standardised features, ``mean`` and ``scale`` (V, F) of them,
    ``half`` (V, N, n) half-widths of the boxes (inf where there are too few scores), ``scores`` (V,) their number."""

    matrix: Floats
    mean: Floats
    scale: Floats
    half: Floats
    scores: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Boxes:
    """How calibrated sets go on: each step has a box of its own, ``center`` (V, N, n) and ``generators`` (V, N, n, n),
    whatever cut the one before."""

    center: Floats
    generators: Floats

    @property
    def horizon(self) -> int:
        """Steps N."""
        steps: int = self.center.shape[1]
        return steps

    def begin(self, start: FactorSet, vehicle: NDArray[np.intp]) -> FactorSet:
        """The sets (R) as they are."""
        return start

    def advance(self, sets: FactorSet, k: int, vehicle: NDArray[np.intp]) -> tuple[FactorSet, NDArray[np.bool_]]:
        """The boxes (R) after step ``k`` of the vehicles (R,)."""
        return FactorSet.zonotope(self.center[vehicle, k], self.generators[vehicle, k]), np.zeros(len(vehicle), bool)


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Features (B, S, F) at each sample, the leading ``base`` of which are known at that sample; ``known`` (B, S)."""

    values: Floats
    base: int
    per_step: int
    known: NDArray[np.bool_]


def least_scores(confidence: float) -> int:
    """Number of scores below which the rank statistic of this confidence does not exist."""
    return int(np.ceil(confidence / (1 - confidence) - 1e-9))


def features(
    block: Block, x: Floats, profile: VehicleProfile, layout: Layout, horizon: int, *, planned: bool
) -> Features:
    """Features at every sample of a block; with ``planned`` the later inputs follow, one group per step."""
    d = increments(x, layout) / profile.sample_time
    run = runs(block.linked)
    earlier = []
    for lag in range(1, LAGGED_INCREMENTS + 1):
        shifted = np.zeros_like(d)
        shifted[:, lag:] = d[:, :-lag]
        earlier.append(shifted)
    inputs = lagged_inputs(block, layout)
    columns = [np.ones((*x.shape[:2], 1)), x[..., layout.free], *earlier, inputs]
    names, roles = profile.state_names, profile.roles
    speed = None
    if roles.speed is not None:
        speed = x[..., [names.index(roles.speed)]]
        if layout.pose is not None:
            turning = earlier[0][..., [layout.pose[2]]]
            columns += [speed * turning, speed**2, speed**2 * turning, speed * turning**2]
        if roles.steering is not None:
            steering = profile.input_names.index(roles.steering)
            columns.append(speed * inputs[..., steering :: layout.m])
    base = np.concatenate(columns, axis=-1)
    later = []
    known = inputs_known(block, run, layout) & (run >= LAGGED_INCREMENTS)
    if planned:
        for step in range(1, horizon):
            ahead = np.zeros_like(block.u)
            ahead[:, :-step] = block.u[:, step:]
            later.append(ahead)
            if speed is not None and roles.steering is not None:
                later.append(speed * ahead[..., [profile.input_names.index(roles.steering)]])
    per_step = sum(a.shape[-1] for a in later) // max(horizon - 1, 1)
    return Features(np.concatenate([base, *later], axis=-1), base.shape[-1], per_step, known)


def fit(block: Block, profile: VehicleProfile, layout: Layout, horizon: int, *, planned: bool) -> Calibrated:
    """Fit the models and boxes of the vehicles of a block (B, S)."""
    x = unwrapped(block, layout)
    data = features(block, x, profile, layout, horizon, planned=planned)
    d = increments(x, layout) * _rate(block, profile)[..., None]
    usable = _usable(block, data.known, horizon, planned)
    weight = usable[..., None].astype(np.float64)
    count = np.maximum(weight.sum(axis=1), 1.0)
    mean = (data.values * weight).sum(axis=1) / count
    scale = np.sqrt((((data.values - mean[:, None]) * weight) ** 2).sum(axis=1) / count)
    constant = scale <= 1e-9 * (1.0 + np.abs(mean))
    mean, scale = np.where(constant, 0.0, mean), np.where(constant, 1.0, scale)
    phi = (data.values - mean[:, None]) / scale[:, None] * weight
    ahead = np.stack([np.concatenate([d[:, h:], np.zeros_like(d[:, :h])], axis=1) for h in range(horizon)], axis=2)
    matrix = _ridge(phi, ahead * weight[..., None], data, horizon)
    errors = np.zeros_like(ahead)
    fold = _folds(usable)
    for number in range(FOLDS):
        inside = (fold == number)[..., None]
        trained = _ridge(phi * ~inside, ahead * weight[..., None] * ~inside[..., None], data, horizon)
        errors = np.where(inside[..., None], _errors(trained, phi, x, d, layout, horizon), errors)
    half, scores = _boxes(errors, usable, profile.confidence)
    return Calibrated(matrix, mean, scale, half, scores)


def predict(
    model: Calibrated, block: Block, profile: VehicleProfile, layout: Layout, plan: Floats | None
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Centers (B, N, n) and generators (B, N, n, n) from the newest sample of a block; ``known`` (B,) says where
    the features were complete. ``plan`` (B, N - 1, m) are the later inputs if the model was fitted with them."""
    horizon = model.half.shape[1]
    x = unwrapped(block, layout)
    data = features(block, x, profile, layout, horizon, planned=False)
    values = data.values[:, -1]
    if plan is not None:
        groups = []
        for step in range(horizon - 1):
            groups.append(plan[:, step])
            if profile.roles.speed is not None and profile.roles.steering is not None:
                speed = x[:, -1, profile.state_names.index(profile.roles.speed)]
                steering = plan[:, step, profile.input_names.index(profile.roles.steering)]
                groups.append((speed * steering)[:, None])
        values = np.concatenate([values, *groups], axis=-1)
    phi = ((values - model.mean) / model.scale)[:, None]
    centers = _rollout(model.matrix, phi, x[:, -1:], layout)[:, 0]
    generators = model.half[..., None] * np.eye(layout.n)
    if layout.pose is not None:
        angle = np.broadcast_to(x[:, -1, None, None, layout.pose[2]], (*generators.shape[:2], layout.n))
        position = list(layout.pose[:2])
        turned = rotate(angle, np.swapaxes(generators[:, :, position], -1, -2))
        generators[:, :, position] = np.swapaxes(turned, -1, -2)
    return centers, generators, data.known[:, -1]


def _rate(block: Block, profile: VehicleProfile) -> Floats:
    """Nominal over actual sample interval (B, S) of the increment that starts at each sample."""
    rate = np.ones(block.t.shape)
    gap = np.diff(block.t, axis=1).astype(np.float64)
    rate[:, :-1] = np.where(block.linked[:, 1:], profile.sample_time_ns / np.where(gap > 0, gap, 1.0), 1.0)
    return rate


def _usable(block: Block, known: NDArray[np.bool_], horizon: int, planned: bool) -> NDArray[np.bool_]:
    """Samples whose features are complete and whose next ``horizon`` samples are there."""
    usable = known.copy()
    size = known.shape[1]
    for step in range(1, horizon + 1):
        if step >= size:
            return np.zeros_like(usable)
        usable[:, :-step] &= block.linked[:, step:]
        usable[:, size - step :] = False
        if planned and step < horizon:
            usable[:, :-step] &= block.input_known[:, step:]
    return usable


def _ridge(phi: Floats, ahead: Floats, data: Features, horizon: int) -> Floats:
    """M (B, N, n, F) for each step on the features known by then, zero on the later ones."""
    vehicles, _, total = phi.shape
    n = ahead.shape[-1]
    rows = np.maximum((np.abs(phi).sum(axis=-1) > 0).sum(axis=1), 1)[:, None, None]
    gram = np.swapaxes(phi, 1, 2) @ phi + RIDGE * rows * np.eye(total)
    right = np.swapaxes(phi, 1, 2) @ ahead.reshape(vehicles, -1, horizon * n)
    matrix = np.zeros((vehicles, horizon, n, total))
    for h in range(horizon):
        size = data.base + h * data.per_step if data.per_step else data.base
        solved = np.linalg.solve(gram[:, :size, :size], right[:, :size, h * n : (h + 1) * n])
        matrix[:, h, :, :size] = np.swapaxes(solved, 1, 2)
    return matrix


def _folds(usable: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Contiguous folds (B, S) of about equal numbers of usable samples; -1 elsewhere."""
    rank = np.cumsum(usable, axis=1) - 1
    total = np.maximum(usable.sum(axis=1, keepdims=True), 1)
    return np.where(usable, np.minimum(rank * FOLDS // total, FOLDS - 1), -1)


def _rollout(matrix: Floats, phi: Floats, x: Floats, layout: Layout) -> Floats:
    """Predicted states (B, S, N, n) from each sample."""
    vehicles, size = x.shape[:2]
    horizon, n = matrix.shape[1:3]
    flat = phi @ np.swapaxes(matrix.reshape(vehicles, horizon * n, -1), 1, 2)
    steps = flat.reshape(vehicles, size, horizon, n)
    if layout.pose is None:
        return np.asarray(x[:, :, None] + np.cumsum(steps, axis=2))
    first, second, heading = layout.pose
    centers = x[:, :, None] + np.cumsum(steps, axis=2)
    before = np.concatenate([x[:, :, None, heading], centers[:, :, :-1, heading]], axis=2)
    moved = np.cumsum(rotate(before, steps[..., [first, second]]), axis=2)
    centers[..., [first, second]] = x[:, :, None, [first, second]] + moved
    return centers


def _errors(matrix: Floats, phi: Floats, x: Floats, d: Floats, layout: Layout, horizon: int) -> Floats:
    """Errors E (B, S, N, n) of the predictions, in the frame of the sample they start from."""
    centers = _rollout(matrix, phi, x, layout)
    errors = np.zeros_like(centers)
    for h in range(1, horizon + 1):
        errors[:, :-h, h - 1] = x[:, h:] - centers[:, :-h, h - 1]
    for i in layout.angles:
        errors[..., i] = wrap(errors[..., i])
    if layout.pose is not None:
        position = list(layout.pose[:2])
        errors[..., position] = rotate(-x[:, :, None, layout.pose[2]], errors[..., position])
    return errors


def _boxes(errors: Floats, usable: NDArray[np.bool_], confidence: float) -> tuple[Floats, NDArray[np.int64]]:
    """Half-widths (B, N, n): each component's own quantile, times the rank statistic of the greatest scaled error.

    Scaling by a quantile rather than by a mean balances the components where it matters, in their tails.
    """
    count = usable.sum(axis=1)
    ranked = np.sort(np.where(usable[..., None, None], np.abs(errors), np.inf), axis=1)
    tail = np.clip(np.ceil(count * confidence).astype(np.int64) - 1, 0, None)[:, None, None, None]
    size = np.take_along_axis(ranked, np.broadcast_to(tail, (len(count), 1, *errors.shape[2:])), axis=1)[:, 0]
    size = np.maximum(np.where(np.isfinite(size), size, 1.0), 1e-12)
    scores = np.where(usable[..., None], (np.abs(errors) / size[:, None]).max(axis=-1), np.inf)
    rank = np.ceil((count + 1) * confidence - 1e-9).astype(np.int64)
    ordered = np.sort(scores, axis=1)
    place = np.minimum(rank - 1, scores.shape[1] - 1)[:, None, None]
    chosen = np.take_along_axis(ordered, np.broadcast_to(place, (len(count), 1, scores.shape[2])), axis=1)[:, 0]
    chosen = np.where((rank <= count)[:, None], chosen, np.inf)
    return chosen[..., None] * size, count
