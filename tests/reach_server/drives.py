"""Vehicles whose true dynamics and bounds are known, and what they do: the ground truth of the containment tests."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import StateFlag, VehicleProfile, parse_profile
from reach_server.data.regressors import RegressorSpec, transitions
from reach_server.data.window import Block, SampleBatch
from reach_server.numeric.types import FloatArray
from reach_server.sets import support
from reach_server.sets.raw import RawSets
from vehicle_agent.simulate import Drive, simulate_history
from vehicle_agent.svea import SveaParameters, increment, jacobian_bounds, step
from vehicle_agent.svea import profile as svea_profile

SVEA = SveaParameters()
PROFILE = svea_profile(SVEA)
LAYOUT = RegressorSpec.of(PROFILE)
START = 10**18


def history(seed: int, samples: int = 420) -> Drive:
    """A drive over all speeds and steering angles."""
    return _history(seed, samples)


@lru_cache
def _history(seed: int, samples: int) -> Drive:
    return simulate_history(seed, samples)


def samples_of(
    drive: Drive, start: int, stop: int, slot: int = 0, *, epoch: int = 1, flags: StateFlag = StateFlag.NONE
) -> SampleBatch:
    """Samples ``start`` to ``stop - 1`` of a drive, as they come from its sensor."""
    k = np.arange(start, stop)
    return SampleBatch(
        np.full(len(k), slot, dtype=np.intp),
        np.full(len(k), epoch, dtype=np.uint64),
        k.astype(np.uint64),
        START + k * SVEA.dt_ns,
        np.full(len(k), int(flags), dtype=np.uint32),
        drive.measured[k],
        drive.inputs[k],
    )


def block_of(x: FloatArray, u: FloatArray, linked: NDArray[np.bool_] | None = None) -> Block:
    """A block (1, S) of consecutive samples."""
    count = len(x)
    if linked is None:
        linked = np.arange(count) > 0
    yes = np.ones((1, count), dtype=bool)
    t = START + np.arange(count, dtype=np.int64)[None] * SVEA.dt_ns
    return Block(t, x[None], u[None], yes, yes, linked[None])


def dynamics(xi: FloatArray) -> FloatArray:
    """True body-frame increment (..., 4) of the SVEA at regressors (..., 7)."""
    return increment(SVEA, xi[..., 0], xi[..., 5], xi[..., 2])


def noise(rng: np.random.Generator, generators: FloatArray, count: int) -> FloatArray:
    """Members (count, n) of a noise set, many of them at its corners."""
    factors = rng.uniform(-1, 1, (count, generators.shape[1]))
    factors = np.where(rng.random((count, 1)) < 0.5, np.sign(factors), factors)
    return np.asarray(factors @ generators.T)


def inside(sets: RawSets, row: int, points: FloatArray, rng: np.random.Generator, count: int = 60) -> NDArray[np.bool_]:
    """Which points (K, n) pass the support inequality of a set in axes and random directions; only members pass all."""
    n = sets.center.shape[1]
    d = np.concatenate([np.eye(n), -np.eye(n), rng.normal(size=(count, n))])
    # Directions are drawn in units of the set, so that no coordinate drowns the others.
    d /= np.maximum(np.abs(sets.generators[row]).sum(axis=1), 1e-9)
    height = support.constrained_support(sets.center[row], sets.generators[row], sets.matrix[row], sets.offset[row], d)
    return np.asarray((points @ d.T <= height + 1e-9 * (1 + np.abs(height))).all(axis=1))


class World:
    """A system in the world frame with a lagged input, a mild nonlinearity and noise along slanted generators.

    x+ = A x + 0.05 sin(2 x) + B0 u_k + B1 u_{k-1} + w;  |df/dx - A| <= 0.1.
    """

    A = np.array([[0.95, 0.1], [-0.08, 0.9]])
    B0 = np.array([0.05, 0.1])
    B1 = np.array([0.02, -0.05])

    def __init__(self) -> None:
        middle = np.column_stack([self.A, self.B0, self.B1])
        spread = np.column_stack([0.1 * np.eye(2), np.zeros((2, 2))]) + 1e-12
        self.profile: VehicleProfile = parse_profile(
            {
                "class": "world",
                "state": {"a": "m", "b": "m"},
                "inputs": {"u": {"unit": "m", "limits": [-1.0, 1.0], "rate": 10.0}},
                "sample_time": SVEA.dt,
                "input_lags": 1,
                "window": 150,
                "noise": {
                    "process": {"generators": [[0.01, 0.004], [0.008, -0.004]], "origin": "given"},
                    "measurement": {"generators": [[0.01, 0.0], [0.01, 0.005]], "origin": "given"},
                },
                "lipschitz": {
                    "lower": (middle - spread).tolist(), "upper": (middle + spread).tolist(), "origin": "given",
                },
                "future_inputs": "rate",
                "maps_to": {"x1": "a", "x2": "b"},
            }
        )  # fmt: skip
        assert self.profile.noise.process is not None
        assert self.profile.noise.measurement is not None
        self.process = self.profile.noise.process.matrix()
        self.measurement = self.profile.noise.measurement.matrix()
        self.layout = RegressorSpec.of(self.profile)

    def f(self, xi: FloatArray) -> FloatArray:
        """Noise-free next state (..., 2) at regressors (..., 4)."""
        x = xi[..., :2]
        return np.asarray(x @ self.A.T + 0.05 * np.sin(2 * x) + xi[..., [2]] * self.B0 + xi[..., [3]] * self.B1)

    def drive(self, seed: int, samples: int = 160) -> Drive:
        """Truth, measurements and inputs."""
        rng = np.random.default_rng(seed)
        u = rng.uniform(-1, 1, (samples, 1))
        x = np.zeros((samples, 2))
        for k in range(1, samples):
            lagged = u[k - 2] if k > 1 else np.zeros(1)
            x[k] = self.f(np.concatenate([x[k - 1], u[k - 1], lagged])) + noise(rng, self.process, 1)[0]
        return Drive(x, x + noise(rng, self.measurement, samples), u)


def svea_transitions(drive: Drive) -> tuple[FloatArray, FloatArray, FloatArray]:
    """True regressors (T, 7), measured ones (T, 7) and measured targets (T, 4) of the usable transitions."""
    data = transitions(block_of(drive.measured, drive.inputs), LAYOUT)
    true = transitions(block_of(drive.truth, drive.inputs), LAYOUT)
    usable = data.usable[0]
    return true.z[0, usable], data.z[0, usable], data.target[0, usable]


__all__ = [
    "LAYOUT", "PROFILE", "START", "SVEA", "FloatArray", "World", "block_of", "dynamics", "history", "inside",
    "jacobian_bounds", "noise", "samples_of", "step", "svea_transitions",
]  # fmt: skip
