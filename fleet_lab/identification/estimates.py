"""What a recording says about timing, measurement noise and delay."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import RecordingError
from fleet_bus.messages import VehicleProfile
from reach_server.data.regressors import RegressorSpec, rotate
from reach_server.numeric.types import FloatArray
from vehicle_agent.recording import Recording

#: Tolerances tried, as parts of the sample time, and the share of the intervals that one must hold.
TOLERANCES: Final = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.75)
TOLERATED: Final = 0.99
#: Bound of the measurement noise in standard deviations.
NOISE_FACTOR: Final = 4.0
#: Least third differences from which a deviation is estimated.
LEAST_DIFFERENCES: Final = 30

#: Longest delay looked for, and how far ahead the increments go that inputs must explain, s.
_LONGEST_DELAY: Final = 0.45
_AHEAD: Final = 0.15
_MOST_LAGS: Final = 32
_FOLDS: Final = 10
_RIDGE: Final = 1e-4
#: How much worse than the best, relative, fewer lags may be.
_SLACK: Final = 0.02
#: Part of the greatest speed below which a vehicle counts as standing.
_STANDING: Final = 0.01


@dataclass(frozen=True, slots=True)
class Timing:
    """Sample time in s, tolerance as a part of it, ``share`` of the intervals within it, and all ``intervals``."""

    sample_time: float
    tolerance: float
    share: float
    intervals: FloatArray


@dataclass(frozen=True, slots=True)
class NoiseEstimate:
    """Standard deviation (n) of the measurement of each state, its bound, and from how it was found."""

    deviation: tuple[float, ...]
    bound: tuple[float, ...]
    how: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Lags:
    """Number of lagged inputs chosen, and by state the cross-validated error of each number tried, as a part of how
    much its increments vary."""

    chosen: int
    tried: tuple[int, ...]
    error: dict[str, tuple[float, ...]]


def intervals_of(recordings: Sequence[Recording]) -> FloatArray:
    """All sample intervals within segments, s; raise ``RecordingError`` where there are none."""
    found = [np.diff(recording.t[rows]) for recording in recordings for rows in recording.segments()]
    joined = np.concatenate(found) if found else np.zeros(0)
    if len(joined) < 2:
        names = ", ".join(recording.name for recording in recordings)
        raise RecordingError(f"{names}: no segment has three samples: nothing can be estimated from single samples")
    return joined


def timing(recordings: Sequence[Recording], sample_time: float | None, tolerance: float | None) -> Timing:
    """Sample time (the roundest number within 1.5 % of the median interval) and tolerance, where not given.

    The tolerance is the least one tried that holds 99 % of the intervals, else the largest one tried.
    """
    intervals = intervals_of(recordings)
    chosen = _round_number(float(np.median(intervals))) if sample_time is None else sample_time
    off = np.abs(intervals - chosen) / chosen
    share = {t: float((off <= t).mean()) for t in (TOLERANCES if tolerance is None else (tolerance,))}
    held = [t for t, part in share.items() if part >= TOLERATED]
    slack = tolerance or max(held[0] if held else TOLERANCES[-1], 0.25)
    return Timing(chosen, slack, float((off <= slack).mean()), intervals)


def _round_number(value: float) -> float:
    for digits in (1, 2, 3):
        rounded = float(f"{value:.{digits}g}")
        if abs(rounded - value) <= 0.015 * value:
            return rounded
    return float(f"{value:.4g}")


def measurement_noise(recordings: Sequence[Recording], profile: VehicleProfile) -> NoiseEstimate:
    """Deviation of each measured state from third differences, bound 4 deviations; columns as in the profile.

    Over three sample times a vehicle moves almost along a parabola, which third differences remove, and independent
    errors of deviation σ leave √20 σ of them: ``σ = 1.4826 median|Δ³y| / √20``. What is left of the motion makes this
    too large, several times at 20–30 Hz, so samples at which the vehicle stands are preferred where there are enough.
    A localisation that is worse in motion is taken for better than it is then.
    Slow errors (a drifting localisation) do not show. The two positions get the larger of theirs. Where most third
    differences are zero (a held or coarse value), their mean square is taken.
    """
    speed = None if profile.roles.speed is None else profile.state_names.index(profile.roles.speed)
    pieces: list[FloatArray] = []
    still: list[NDArray[np.bool_]] = []
    fastest = 0.0 if speed is None else max(float(np.abs(r.x[:, speed]).max()) for r in recordings)
    for recording in recordings:
        for rows in recording.segments():
            x = recording.x[rows].copy()
            x[:, profile.angles] = np.unwrap(x[:, profile.angles], axis=0)
            near = np.abs(np.diff(recording.t[rows]) / profile.sample_time - 1) <= profile.tolerance
            regular = near[:-2] & near[1:-1] & near[2:]
            pieces.append(np.diff(x, 3, axis=0)[regular])
            slow = np.zeros(len(x), bool) if speed is None else np.abs(x[:, speed]) <= _STANDING * fastest
            still.append((slow[:-3] & slow[1:-2] & slow[2:-1] & slow[3:])[regular])
    third, standing = np.concatenate(pieces), np.concatenate(still)
    if len(third) < LEAST_DIFFERENCES:
        raise RecordingError(
            f"{len(third)} stretches of four samples at the sample time {profile.sample_time:g} s: at least "
            f"{LEAST_DIFFERENCES} are needed; correct sample_time or tolerance, or give more recordings"
        )
    stood = int(standing.sum()) >= 2 * LEAST_DIFFERENCES
    deviation, how = [], []
    for i in range(third.shape[1]):
        found, way = _deviation(third[:, i])
        at_rest, rest_way = _deviation(third[standing, i]) if stood else (0.0, "")
        if 0 < at_rest < found and i != speed:
            found, way = at_rest, f"{rest_way}, standing (all samples: {found:.2g})"
        deviation.append(found)
        how.append(way)
    pair = list(profile.position) if profile.roles.position is not None else []
    for i in pair:
        deviation[i] = max(deviation[j] for j in pair)
    return NoiseEstimate(tuple(deviation), tuple(NOISE_FACTOR * d for d in deviation), tuple(how))


def _deviation(third: FloatArray) -> tuple[float, str]:
    spread = 1.4826 * float(np.median(np.abs(third - np.median(third)))) / np.sqrt(20)
    if spread > 0:
        return float(spread), "median third difference"
    return float(np.sqrt((third**2).mean() / 20)), "mean square third difference"


def input_lags(recordings: Sequence[Recording], profile: VehicleProfile) -> Lags:
    """How many lagged inputs explain what the vehicle does: for each state the fewest within 2 % of its least error,
    and the most of these.

    Ridge regression of the increment over ``_AHEAD`` s (positions in the frame of the vehicle where the profile says
    so) on the states, their products with the speed, and the inputs lagged up to q samples and in between; errors on
    contiguous folds, since neighbours in time are alike. All q are judged on the same samples.
    """
    if not profile.inputs:
        return Lags(0, (), {})
    ahead = max(1, round(_AHEAD / profile.sample_time))
    shortest = int(np.median([rows.stop - rows.start for r in recordings for rows in r.segments()]))
    most = min(_MOST_LAGS, int(_LONGEST_DELAY / profile.sample_time), max(shortest // 4, 1))
    now, before, target = _increments(recordings, profile, ahead, most)
    tried = tuple(sorted({*range(min(most, 4) + 1), *range(6, most + 1, 2)}))
    if len(target) < 20 * _FOLDS:
        return Lags(min(most, 4), (), {})
    error = np.stack([_validated(_with_inputs(now, before[:, most - q :], profile), target) for q in tried], axis=1)
    good = error <= (1 + _SLACK) * error.min(axis=1, keepdims=True)
    by_state = dict(zip(profile.state_names, map(tuple, error.tolist()), strict=True))
    return Lags(max(tried[int(first)] for first in good.argmax(axis=1)), tried, by_state)


def _increments(
    recordings: Sequence[Recording], profile: VehicleProfile, ahead: int, most: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Free states (T, ·), inputs from ``most`` samples before to the last one that matters (T, ·, m), increments."""
    layout = RegressorSpec.of(profile)
    now, inputs, targets = [], [], []
    for recording in recordings:
        for rows in recording.segments():
            x, u = recording.x[rows].copy(), recording.u[rows]
            if len(x) <= most + ahead:
                continue
            x[:, profile.angles] = np.unwrap(x[:, profile.angles], axis=0)
            near = np.abs(np.diff(recording.t[rows]) / profile.sample_time - 1) <= profile.tolerance
            good = np.concatenate([near & np.isfinite(u[:-1]).all(axis=1), [False]])
            broken = np.concatenate([[0], np.cumsum(~good)])
            at = np.arange(most, len(x) - ahead)
            at = at[broken[at + ahead] == broken[at - most]]
            d = x[at + ahead] - x[at]
            if layout.pose is not None:
                d[:, list(layout.pose[:2])] = rotate(-x[at, layout.pose[2]], d[:, list(layout.pose[:2])])
            now.append(x[at][:, list(layout.free)])
            inputs.append(u[at[:, None] + np.arange(-most, ahead)])
            targets.append(d)
    if not targets:
        empty = np.zeros((0, 1))
        return empty, np.zeros((0, most + ahead, len(profile.inputs))), empty
    return np.concatenate(now), np.concatenate(inputs), np.concatenate(targets)


def _with_inputs(now: FloatArray, inputs: FloatArray, profile: VehicleProfile) -> FloatArray:
    columns = [now, inputs.reshape(len(now), -1)]
    if profile.roles.speed is not None:
        layout = RegressorSpec.of(profile)
        index = layout.free.index(profile.state_names.index(profile.roles.speed))
        speed = now[:, [index]]
        columns.append(speed * now)
        if profile.roles.steering is not None:
            columns.append(speed * inputs[:, :, profile.input_names.index(profile.roles.steering)])
    return np.concatenate(columns, axis=1)


def _validated(features: FloatArray, target: FloatArray) -> FloatArray:
    """Held-out error (n) of each target (T, n), relative to how much it varies; 1 where it does not."""
    count = len(features)
    fold = np.arange(count) * _FOLDS // count
    spread = features.std(axis=0)
    scaled = (features - features.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    error = np.zeros_like(target)
    for number in range(_FOLDS):
        held = fold == number
        z, y = scaled[~held], target[~held]
        mean = y.mean(axis=0)
        gram = z.T @ z + _RIDGE * len(z) * np.eye(z.shape[1])
        error[held] = target[held] - mean - scaled[held] @ np.linalg.solve(gram, z.T @ (y - mean))
    scale = target.std(axis=0)
    return np.asarray(np.where(scale > 0, np.sqrt((error**2).mean(axis=0)) / np.where(scale > 0, scale, 1.0), 1.0))
