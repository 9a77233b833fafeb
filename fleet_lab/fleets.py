"""Simulated vehicles for the benchmarks of the engine, with predicates that all of them keep and that often cut."""

from dataclasses import dataclass

import numpy as np

from fleet_bus.messages import VehicleProfile, parse_profile
from reach_server.data.window import SampleBatch
from reach_server.numeric.types import FloatArray
from side_info import Scenario
from vehicle_agent import svea

START = 10**18
#: Lags of the inputs: the steering of the cars acts four samples late.
LAGS = 4
#: Different drives; vehicles beyond that share them.
DRIVES = 1000
CAR = svea.SveaParameters(steering_delay=LAGS)


@dataclass(frozen=True, slots=True, eq=False)
class Drives:
    """``truth`` and ``measured`` (D, K, n), ``inputs`` (D, K, m) of vehicles with a ``profile``.

    ``bounded`` are the two states that the predicates speak about."""

    truth: FloatArray
    measured: FloatArray
    inputs: FloatArray
    profile: VehicleProfile
    bounded: tuple[int, int]

    def batch(self, vehicles: int, first: int, last: int | None = None) -> SampleBatch:
        """Sample ``first`` of every vehicle, or all from there to ``last`` - 1; the drives are dealt out in turn."""
        k = np.repeat(np.arange(first, first + 1 if last is None else last), vehicles)
        slots = np.tile(np.arange(vehicles), len(k) // vehicles)
        drive = slots % len(self.truth)
        return SampleBatch(
            slots, np.ones(len(k), dtype=np.uint64), k.astype(np.uint64),
            START + k * self.profile.sample_time_ns, np.zeros(len(k), dtype=np.uint32),
            self.measured[drive, k], self.inputs[drive, k],
        )  # fmt: skip

    def plan(self, vehicles: int, k: int) -> FloatArray:
        """Inputs (V, N - 1, m) of the samples after ``k``."""
        return self.inputs[np.arange(vehicles) % len(self.truth), k + 1 : k + self.profile.horizon]

    def scenario(self, predicates: int) -> Scenario:
        """That many two-sided bounds, always: of one state, of another, then of slanted combinations of both."""
        first, second = (self.truth[..., i] for i in self.bounded)
        one, other = (self.profile.state_names[i] for i in self.bounded)
        conditions = []
        for number in range(predicates):
            angle = np.pi * number / max(predicates, 2)
            a, b = round(float(np.cos(angle)), 9), round(float(np.sin(angle)), 9)
            value = a * first + b * second
            middle, half = (value.max() + value.min()) / 2, (value.max() - value.min()) / 2 * 1.001
            conditions.append(f'  B{number}: "{half:.9f} - abs({a} * {one} + {b} * {other} - {middle:.9f}) >= 0"')
        names = " and ".join(f"B{number}" for number in range(predicates))
        units = ", ".join(f"{name}: {self.profile.state[name].unit}" for name in (one, other))
        return Scenario.parse(
            f"scenario: bounds\nversion: 1\nstate: {{{units}}}\ntime: {{zero: on_start, semantics: sampled}}\n"
            "regions:\n" + "\n".join(conditions) + f"\nassume: always[0:10000 s]({names})\n",
            "benchmark",
        )


def cars(samples: int, **changes: object) -> Drives:
    """Cars at about 1 m/s, steered back to the middle of a lane along x; every bound is given."""
    fields = svea.profile(CAR).model_dump(by_alias=True)
    profile = VehicleProfile.model_validate({**fields, **changes})
    rng = np.random.default_rng(0)
    process, sensor = np.array(CAR.process_noise), np.array(CAR.sensor_noise)
    state = np.zeros((DRIVES, 4))
    state[:, 1], state[:, 3] = rng.uniform(-0.1, 0.1, DRIVES), 1.0
    truth, measured = np.empty((DRIVES, samples, 4)), np.empty((DRIVES, samples, 4))
    inputs = np.zeros((DRIVES, samples, 2))
    for k in range(samples):
        truth[:, k] = state
        measured[:, k] = state + rng.uniform(-1, 1, state.shape) * sensor
        steering = -0.4 * state[:, 1] - 0.5 * state[:, 2] + rng.uniform(-0.1, 0.1, DRIVES)
        inputs[:, k] = np.column_stack([steering, 1.0 + rng.uniform(-0.05, 0.05, DRIVES)])
        acting = inputs[:, k - LAGS, 0] if k >= LAGS else np.zeros(DRIVES)
        state = svea.step(CAR, state, acting, inputs[:, k, 1], rng.uniform(-1, 1, state.shape) * process)
    measured[..., 2] = np.remainder(measured[..., 2] + np.pi, 2 * np.pi) - np.pi
    return Drives(truth, measured, inputs, profile, (1, 3))


def linear(samples: int, dimension: int, **changes: object) -> Drives:
    """Stable linear systems of ``dimension`` states and two inputs with lags, world frame; every bound is given."""
    rng = np.random.default_rng(1)
    half_w, half_v = 0.01, 0.005
    rotation = np.linalg.qr(rng.standard_normal((dimension, dimension)))[0]
    matrix = 0.9 * rotation
    gains = rng.uniform(-0.3, 0.3, (dimension, 2))
    columns = dimension + 2 * (LAGS + 1)
    slope = np.zeros((dimension, columns))
    slope[:, :dimension], slope[:, dimension : dimension + 2] = matrix, gains
    names = [f"x{i}" for i in range(dimension)]
    profile = parse_profile(
        {
            "class": "linear",
            "state": dict.fromkeys(names, "m"),
            "inputs": {name: {"unit": "m", "limits": [-1.0, 1.0]} for name in ("a", "b")},
            "sample_time": CAR.dt,
            "input_lags": LAGS,
            "noise": {
                "process": {"box": [half_w] * dimension, "origin": "given"},
                "measurement": {"box": [half_v] * dimension, "origin": "given"},
            },
            "lipschitz": {"lower": (slope - 1e-9).tolist(), "upper": (slope + 1e-9).tolist(), "origin": "given"},
            "future_inputs": "plan",
            **changes,
        }
    )
    state = np.zeros((DRIVES, dimension))
    truth, measured = np.empty((DRIVES, samples, dimension)), np.empty((DRIVES, samples, dimension))
    inputs = rng.uniform(-1, 1, (DRIVES, samples, 2))
    for k in range(samples):
        truth[:, k], measured[:, k] = state, state + rng.uniform(-half_v, half_v, state.shape)
        state = state @ matrix.T + inputs[:, k] @ gains.T + rng.uniform(-half_w, half_w, state.shape)
    return Drives(truth, measured, inputs, profile, (0, 1))
