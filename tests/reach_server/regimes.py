"""Vehicles that do for the first time what their window does not show."""

from dataclasses import dataclass

import numpy as np

from fleet_bus.messages import VehicleProfile, parse_profile
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine
from reach_server.engine.results import Tubes
from reach_server.numeric.types import FloatArray

DT, WINDOW, NOVEL, TOTAL = 0.05, 300, 420, 880
#: Half-widths of process and measurement noise of x, y, yaw, v; the linear vehicle has no yaw.
PROCESS = np.array([1e-4, 1e-4, 1e-4, 1e-3])
MEASUREMENT = np.array([5e-4, 5e-4, 5e-4, 2e-3])
REGIMES = ("parked", "turn", "reverse", "constant input", "frozen sensor")
#: What a regime is the first to show, one of which a note must name.
NEW = {
    "parked": {"throttle"}, "turn": {"steering"}, "reverse": {"throttle"}, "constant input": {"throttle"},
    "frozen sensor": {"v", "throttle"},
}  # fmt: skip
LIMITS = {"v": {"unit": "m/s", "limits": [-3.0, 3.0], "rate": 8.0}, "yaw": {"unit": "rad", "angle": True, "rate": 6.0}}


def profile(*, linear: bool, limited: bool) -> VehicleProfile:
    """A class in its own frame, or of a linear vehicle in the world's, of which every bound is given."""
    v = LIMITS["v"] if limited else "m/s"
    yaw = LIMITS["yaw"] if limited else {"unit": "rad", "angle": True}
    kept = [0, 1, 3] if linear else [0, 1, 2, 3]
    if linear:
        state: dict[str, object] = {"x": "m", "y": "m", "v": v}
        if limited:
            state["y"] = {"unit": "m", "rate": 2.0}
        # Of x, y, v and the inputs: |A|, |B|.
        slopes = [[1.0, 0.0, DT, 0.0, 0.0], [0.0, 1.0, 0.0, DT, 0.0], [0.0, 0.0, 1.0 - 2 * DT, 0.0, 10 * DT]]
        roles: dict[str, object] = {"position": ["x", "y"]}
        if limited:
            state["x"] = {"unit": "m", "rate": 3.0}
    else:
        state = {"x": "m", "y": "m", "yaw": yaw, "v": v}
        slopes = [[DT, 0.0, 0.0], [0.0, 0.0, 0.0], [3 * DT * 0.6, 3 * DT * 3.0, 0.0], [2 * DT, 0.0, 10 * DT]]
        roles = {"position": ["x", "y"], "heading": "yaw", "speed": "v", "steering": "steering"}
    lagged = [[*row, *([0.0] * 2)] for row in slopes]
    return parse_profile(
        {
            "class": "novice", "state": state, "sample_time": DT, "frame": "world" if linear else "body",
            "inputs": {n: {"unit": "1", "limits": [-0.6, 0.6]} for n in ("steering", "throttle")},
            "input_lags": 1, "window": WINDOW, "horizon": 3, "confidence": 0.95, "future_inputs": "limits",
            "noise": {
                "process": {"box": PROCESS[kept].tolist(), "origin": "given"},
                "measurement": {"box": MEASUREMENT[kept].tolist(), "origin": "given"},
            },
            "lipschitz": {"matrix": lagged, "origin": "given"},
            "roles": roles,
        }
    )  # fmt: skip


@dataclass(frozen=True)
class Drive:
    """True and measured states (T, n), inputs (T, 2): steering, throttle."""

    true: FloatArray
    measured: FloatArray
    u: FloatArray


def drive(regime: str, *, linear: bool, seed: int = 0) -> Drive:
    """A drive that shows something new from sample ``NOVEL`` on; every stated bound holds."""
    rng, k = np.random.default_rng(seed), np.arange(TOTAL)
    new = k >= NOVEL
    steering, throttle = 0.3 * np.sin(0.11 * k) + rng.uniform(-0.05, 0.05, TOTAL), np.full(TOTAL, 0.2)
    throttle += 0.1 * np.sin(0.07 * k) + rng.uniform(-0.02, 0.02, TOTAL)
    if regime == "parked":
        steering, throttle = np.where(new, steering, 0.0), np.where(new, throttle, 0.0)
    elif regime == "turn":
        steering = np.where(new, steering, 0.0)
    elif regime == "reverse":
        throttle = np.where(new, -throttle, throttle)
    elif regime == "constant input":
        throttle = np.where(new, throttle, 0.25)
    else:
        throttle = np.where(new, throttle, 0.2)
    still = (regime == "parked") & ~new
    x = np.zeros((TOTAL, 4))
    x[0, 3] = 0.0 if regime == "parked" else 5 * throttle[0]
    for j in range(TOTAL - 1):
        px, py, yaw, v = x[j]
        noise = 0.9 * rng.uniform(-PROCESS, PROCESS)
        if still[j] or (regime == "frozen sensor" and not new[j]):
            noise[3] = 0.0
        turned = 3 * DT * v * steering[j]
        ahead, left = (DT * v, DT * steering[j]) if linear else (DT * v * np.cos(yaw), DT * v * np.sin(yaw))
        x[j + 1] = np.array([px + ahead, py + left, yaw + turned, v + DT * (-2 * v + 10 * throttle[j])]) + noise
    measured = x + rng.uniform(-MEASUREMENT, MEASUREMENT, x.shape)
    if still.any():
        measured[still, 3] = 0.0
    if regime == "frozen sensor":
        # The speed keeps its value, and the sensor says it exactly, for as long as the throttle is constant.
        measured[~new, 3] = x[0, 3]
    measured[:, 2] = (measured[:, 2] + np.pi) % (2 * np.pi) - np.pi
    kept = [0, 1, 3] if linear else [0, 1, 2, 3]
    return Drive(x[:, kept], measured[:, kept], np.column_stack([steering, throttle]))


def tubes_of(made: VehicleProfile, driven: Drive, method: str) -> dict[int, Tubes]:
    """The tubes of a method by sample, of those that it served."""
    engine, found = Engine(made, method=method), {}
    engine.add("car")
    one = np.ones(1, dtype=np.uint64)
    for k in range(TOTAL):
        tubes = engine.step(
            SampleBatch(
                np.zeros(1, dtype=np.intp),
                one,
                one * np.uint64(k),
                np.array([10**18 + k * made.sample_time_ns]),
                np.zeros(1, dtype=np.uint32),
                driven.measured[k : k + 1],
                driven.u[k : k + 1],
            )
        )
        if method in tubes.methods:
            found[k] = tubes
    return found
