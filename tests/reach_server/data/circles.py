"""Samples of a car on a circle, and windows that take them."""

from dataclasses import replace

import numpy as np

from fleet_bus.messages import VehicleProfile, parse_profile
from reach_server.data.regressors import runs, wrap
from reach_server.data.window import SampleBatch, Window
from reach_server.numeric.types import FloatArray

STEP = 50_000_000
START = 10**18
SIZE = 120
ALL = np.array([0])


def profile(**changes: object) -> VehicleProfile:
    fields: dict[str, object] = {
        "class": "car",
        "state": {"x": "m", "y": "m", "yaw": {"unit": "rad", "angle": True}, "v": "m/s"},
        "inputs": {"steering": "rad"},
        "sample_time": 0.05,
        "tolerance": 0.25,
        "frame": "body",
        "window": 100,
        "future_inputs": "learned",
        "roles": {"position": ["x", "y"], "heading": "yaw", "speed": "v"},
    }
    return parse_profile(fields | changes)


def circle(count: int, start: int = 0, slot: int = 0) -> SampleBatch:
    """A car on a circle, at 1 m/s."""
    k = np.arange(start, start + count)
    angle: FloatArray = 0.05 * k.astype(np.float64)
    x = np.column_stack([np.cos(angle), np.sin(angle), wrap(angle + np.pi / 2), np.ones(count)])
    return SampleBatch(
        np.full(count, slot), np.ones(count, dtype=np.uint64), k.astype(np.uint64), START + k * STEP,
        np.zeros(count, dtype=np.uint32), x, 0.1 * np.ones((count, 1)),
    )  # fmt: skip


def moved(batch: SampleBatch, row: int, x: FloatArray) -> SampleBatch:
    """A batch in which one state is another."""
    states = batch.x.copy()
    states[row] = x
    return replace(batch, x=states)


def window(made: VehicleProfile | None = None, vehicles: int = 1) -> Window:
    w = Window(made or profile(), SIZE)
    w.grow(vehicles)
    return w


def run_of(w: Window, slot: int = 0) -> list[int]:
    """Runs of the samples held, oldest first, as far as the window reaches back."""
    linked = w.block(np.array([slot]), int(w.filled(np.array([slot]))[0])).linked
    return [int(run) for run in runs(linked)[0]]
