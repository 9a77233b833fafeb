"""Engines of simulated cars, and scenarios around their drives."""

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from fleet_bus.messages import VehicleProfile
from reach_server.engine.engine import Engine, PlannedInputs
from reach_server.engine.results import Tubes
from reach_server.numeric.types import FloatArray
from side_info import Scenario
from tests.reach_server.drives import PROFILE, inside
from vehicle_agent.simulate import Drive

SMALL = PROFILE.model_copy(update={"window": 150})
NOW = 300


def engine_of(profile: VehicleProfile = SMALL, vehicles: int = 1, **options: object) -> Engine:
    made = Engine(profile, **options)  # type: ignore[arg-type]
    for slot in range(vehicles):
        assert made.add(f"car-{slot}") == slot
    return made


def plan_of(drives: Sequence[Drive], k: int, horizon: int = 10) -> PlannedInputs:
    plan = np.stack([d.inputs[k + 1 : k + horizon] for d in drives])
    return PlannedInputs(plan, np.zeros((len(drives), plan.shape[2])))


def close_to(points: FloatArray, center: FloatArray) -> FloatArray:
    """States whose heading is the one nearest to that of the center."""
    turned = points.copy()
    turned[:, 2] = center[2] + np.mod(points[:, 2] - center[2] + np.pi, 2 * np.pi) - np.pi
    return turned


def assert_holds(tubes: Tubes, row: int, truth: FloatArray) -> None:
    rng = np.random.default_rng(0)
    for k, sets in enumerate(tubes.steps):
        point = close_to(truth[k : k + 1], sets.center[row])
        assert inside(sets, row, point, rng).all(), k


def box_scenario(low: FloatArray, high: FloatArray, name: str = "box", window: str = "0:100 s") -> Scenario:
    return Scenario.parse(
        f"scenario: {name}\nversion: 1\nstate: {{x1: m, x2: m}}\ntime: {{zero: on_start, semantics: sampled}}\n"
        f"regions: {{P: {{box: {{x1: [{low[0]}, {high[0]}], x2: [{low[1]}, {high[1]}]}}}}}}\n"
        f"assume: always[{window}](P)\n"
    )


def assert_finite(tubes: Tubes) -> None:
    arrays = [tubes.area, tubes.area_free, tubes.outline, tubes.hull]
    for sets in (*tubes.steps, *tubes.free):
        arrays += [getattr(sets, f.name) for f in fields(sets)]
    assert all(np.isfinite(array).all() for array in arrays)
    assert (tubes.area >= 0).all()
    assert (tubes.hull[:, :, 0] <= tubes.hull[:, :, 1]).all()
