"""Vehicles and slow twins for the tests of calibrated sets."""

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import StateFlag, VehicleProfile, load_profile, parse_profile
from reach_server.data.regressors import RegressorSpec
from reach_server.data.window import SampleBatch, Window
from reach_server.models.conformal import ConformalPredictor
from reach_server.models.conformal.spec import FeatureSpec
from reach_server.numeric.types import FloatArray
from vehicle_agent.recording import load_recording

START = 10**18
ROOT = Path(__file__).parents[4]

CAR = parse_profile(
    {
        "class": "car", "state": {"x": "m", "y": "m", "yaw": {"unit": "rad", "angle": True}, "v": "m/s"},
        "inputs": {"steering": "rad", "velocity": "m/s"}, "sample_time": 0.1, "frame": "body", "input_lags": 3,
        "window": 300, "future_inputs": "learned", "confidence": 0.95, "horizon": 3,
        "roles": {"position": ["x", "y"], "heading": "yaw", "speed": "v", "steering": "steering"},
    }
)  # fmt: skip
PLAIN = parse_profile(
    {
        "class": "plain", "state": {"a": "m", "b": "m"}, "inputs": {"u": "m"}, "sample_time": 0.1, "input_lags": 1,
        "window": 200, "future_inputs": "learned", "confidence": 0.9, "horizon": 3,
    }
)  # fmt: skip


def drive(samples: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """States (T, 4) and inputs (T, 2) of a car with measurement noise."""
    rng = np.random.default_rng(seed)
    u = np.cumsum(0.1 * rng.normal(size=(samples, 2)), axis=0)
    u = np.stack([0.4 * np.sin(u[:, 0]), 1.0 + 0.5 * np.sin(u[:, 1])], axis=1)
    x = np.zeros((samples, 4))
    for k in range(1, samples):
        px, py, yaw, v = x[k - 1]
        v_new = v + 0.3 * (u[k - 1, 1] - v) + 0.01 * rng.standard_t(4)
        yaw_new = yaw + 0.1 * v / 0.3 * np.tan(u[max(k - 3, 0), 0]) + 0.002 * rng.normal()
        x[k] = px + 0.1 * v * np.cos(yaw), py + 0.1 * v * np.sin(yaw), yaw_new, v_new
    x += rng.normal(size=x.shape) * [0.002, 0.002, 0.004, 0.005]
    x[:, 2] = np.mod(x[:, 2] + np.pi, 2 * np.pi) - np.pi
    return x, u


def stationary(vehicles: int, samples: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """States (V, T, 2) of a stationary process with heavy tails and inputs (V, T, 1) that matter."""
    rng = np.random.default_rng(seed)
    x, u = np.zeros((vehicles, samples, 2)), rng.normal(size=(vehicles, samples, 1))
    w = 0.1 * rng.standard_t(4, size=x.shape)
    for k in range(1, samples):
        x[:, k] = x[:, k - 1] @ np.array([[0.8, 0.1], [-0.2, 0.7]]).T + 0.3 * u[:, k - 1] + w[:, k]
    return x, u


def batch_of(
    x: FloatArray,
    u: FloatArray,
    profile: VehicleProfile,
    slot: int = 0,
    first: int = 0,
    jitter: FloatArray | None = None,
) -> SampleBatch:
    """Consecutive samples of one vehicle; inputs that are NaN are missing."""
    k = np.arange(first, first + len(x))
    t = START + k * profile.sample_time_ns
    if jitter is not None:
        t = t + np.rint(jitter * profile.sample_time_ns).astype(np.int64)
    missing = np.isnan(u).any(axis=1)
    flags = np.where(missing, int(StateFlag.INPUT_MISSING), 0).astype(np.uint32)
    ones = np.ones(len(k), dtype=np.uint64)
    return SampleBatch(np.full(len(k), slot, dtype=np.intp), ones, k.astype(np.uint64), t, flags, x, np.nan_to_num(u))


class Stream:
    """A window and its calibrated models."""

    def __init__(self, profile: VehicleProfile, vehicles: int = 1, *, planned: bool = False) -> None:
        self.profile = profile
        self.window = Window(profile)
        self.window.grow(vehicles)
        layout = RegressorSpec.of(profile)
        self.spec = FeatureSpec.of(profile, layout, profile.horizon, planned=planned)
        self.models = ConformalPredictor(profile, layout, self.window, profile.horizon, planned=planned)
        self.models.grow(vehicles)
        self.slots = np.arange(vehicles)
        for slot in range(vehicles):
            self.models.reset(slot)

    def take(self, *batches: SampleBatch) -> None:
        """Append, learn."""
        self.window.append(SampleBatch.join(list(batches)))
        self.models.observe(self.slots)
        self.models.refit(self.slots)


def rotated(angle: float, vector: FloatArray) -> FloatArray:
    """A planar vector turned by an angle."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]]) @ vector


def shorter(angle: float) -> float:
    """An angle in (-pi, pi]."""
    return float(np.arctan2(np.sin(angle), np.cos(angle)))


def slow_increment(t: NDArray[np.int64], x: FloatArray, k: int, spec: FeatureSpec) -> FloatArray:
    """The change from sample k to the next, as its definition says."""
    d = x[k + 1] - x[k]
    for i in range(spec.n):
        if spec.angles >> i & 1:
            d[i] = shorter(d[i])
    if spec.heading >= 0:
        pair = [spec.first, spec.second]
        d[pair] = rotated(-x[k, spec.heading], d[pair])
    return np.asarray(d * spec.interval / (t[k + 1] - t[k]))


def slow_features(t: NDArray[np.int64], x: FloatArray, u: FloatArray, k: int, spec: FeatureSpec) -> FloatArray:
    """The features of sample k, as their definition says."""
    dt = spec.interval / 1e9
    columns: list[float] = [1.0]
    for i in range(spec.n):
        if spec.free >> i & 1:
            columns += [np.cos(x[k, i]), np.sin(x[k, i])] if spec.angles >> i & 1 else [x[k, i]]
    increments = [slow_increment(t, x, k - lag, spec) / dt for lag in range(1, spec.increments + 1)]
    inputs = [u[k - lag] for lag in range(spec.lags + 1)]
    columns += [value for part in (*increments, *inputs) for value in part]
    if spec.speed >= 0:
        v = x[k, spec.speed]
        if spec.heading >= 0:
            r = increments[0][spec.heading]
            columns += [v * r, v**2, v**2 * r, v * r**2]
        if spec.steering >= 0:
            columns += [v * values[spec.steering] for values in inputs]
    if spec.planned:
        for j in range(1, spec.horizon):
            columns += list(u[k + j])
            if spec.steering >= 0:
                columns.append(v * u[k + j, spec.steering])
    return np.array(columns)


def slow_sizes(t: NDArray[np.int64], x: FloatArray, u: FloatArray, k: int, h: int, spec: FeatureSpec) -> FloatArray:
    """The regressors of the size of the error of step h (from 0), as their definition says."""
    dt = spec.interval / 1e9
    increments = [slow_increment(t, x, k - lag, spec) / dt for lag in range(1, spec.increments + 1)]
    ranges = np.ptp(u[k - spec.lags : k + 1 + (h if spec.planned else 0)], axis=0)
    regressors = [1.0]
    if spec.speed >= 0:
        v = abs(x[k, spec.speed])
        regressors.append(v)
        if spec.heading >= 0:
            r = abs(increments[0][spec.heading])
            regressors += [r, v * r]
    regressors += list(ranges)
    if spec.steering >= 0:
        regressors.append(v * ranges[spec.steering])
    regressors += [abs(increments[0][i]) for i in range(spec.n) if spec.free >> i & 1]
    regressors += list(np.sum([np.abs(a - b) for a, b in pairwise(increments)], axis=0))
    return np.array(regressors)


def slow_center(x: FloatArray, d: FloatArray, spec: FeatureSpec) -> FloatArray:
    """States (N, n) after increments (N, n)."""
    states = [x]
    for step in d:
        new = states[-1] + step
        if spec.heading >= 0:
            pair = [spec.first, spec.second]
            new[pair] = states[-1][pair] + rotated(states[-1][spec.heading], step[pair])
        states.append(new)
    return np.array(states[1:])


def recorded(
    name: str, profile_name: str, segments: list[int]
) -> tuple[VehicleProfile, SampleBatch, NDArray[np.int64]]:
    """Segments of a recording in some order, with their profile: samples, and the segment of each."""
    profile = load_profile(ROOT / "fleet_lab" / "profiles" / f"{profile_name}.yaml")
    recording = load_recording(ROOT / "tests" / "data" / "recordings" / f"{name}.npz").select(profile)
    rows = np.concatenate([np.flatnonzero(recording.segment == segment) for segment in segments])
    segment = recording.segment[rows]
    new = np.r_[True, np.diff(segment) != 0]
    gaps = np.where(new, 10**9, np.rint(np.diff(recording.t[rows], prepend=0.0) * 1e9)).astype(np.int64)
    missing = np.isnan(recording.u[rows]).any(axis=1)
    flags = new * int(StateFlag.NEW_TRAJECTORY) | missing * int(StateFlag.INPUT_MISSING)
    count = len(rows)
    batch = SampleBatch(
        np.zeros(count, dtype=np.intp), np.ones(count, dtype=np.uint64), np.arange(count, dtype=np.uint64),
        np.cumsum(gaps), flags.astype(np.uint32), recording.x[rows].copy(), np.nan_to_num(recording.u[rows]),
    )  # fmt: skip
    return profile, batch, segment
