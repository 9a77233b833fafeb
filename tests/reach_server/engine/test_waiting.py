"""Who gets a tube, who waits for what, and what limits alone say meanwhile."""

import numpy as np

from fleet_bus.messages import Label, StateFlag, parse_profile
from fleet_lab.fleets import linear
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine, PlannedInputs
from tests.reach_server.drives import PROFILE, history, samples_of
from tests.reach_server.engine.engines import NOW, SMALL, assert_finite, assert_holds, engine_of, plan_of


def test_who_gets_no_tube_is_told_why() -> None:
    drive = history(1)
    engine = engine_of(SMALL, 4)
    engine.append(SampleBatch.join([samples_of(drive, 0, NOW, slot) for slot in (1, 2)]))
    fresh = samples_of(drive, NOW, NOW + 1, 2, flags=StateFlag.NEW_TRAJECTORY)
    recorded = samples_of(drive, NOW, NOW + 1, 1, flags=StateFlag.HISTORY)
    tubes = engine.step(SampleBatch.join([samples_of(drive, 0, 5), recorded, fresh]))
    assert tubes.vehicles == ()
    assert set(tubes.waiting) == {"car-0", "car-1", "car-2"}
    assert "too few" in tubes.waiting["car-0"]
    assert "history" in tubes.waiting["car-1"]
    assert "lagged" in tubes.waiting["car-2"]
    assert_finite(tubes)
    again = engine.step(samples_of(drive, NOW + 1, NOW + 2, 1))
    assert again.vehicles == ("car-1",)
    assert not again.waiting


def test_without_limits_there_is_no_tube_unless_a_plan_comes() -> None:
    spec = SMALL.model_dump(by_alias=True, exclude_none=True)
    for one in spec["inputs"].values():
        del one["limits"]
    drive = history(1)
    engine = engine_of(parse_profile(spec))
    engine.append(samples_of(drive, 0, NOW))
    tubes = engine.step(samples_of(drive, NOW, NOW + 1))
    assert "limits" in tubes.waiting["car-0"]
    assert engine.step(samples_of(drive, NOW + 1, NOW + 2), plan_of([drive], NOW + 1)).vehicles == ("car-0",)
    unknown = samples_of(drive, NOW + 2, NOW + 3, flags=StateFlag.INPUT_MISSING)
    assert "limits" in engine.step(unknown, plan_of([drive], NOW + 2)).waiting["car-0"]


def test_an_unknown_current_input_may_be_anything_within_its_limits() -> None:
    drive = history(3)
    engine = engine_of()
    engine.append(samples_of(drive, 0, NOW))
    known = engine.predict(np.array([0]))
    assert known.vehicles
    batch = samples_of(drive, NOW, NOW + 1, flags=StateFlag.INPUT_MISSING)
    nothing = SampleBatch(batch.vehicle, batch.epoch, batch.seq, batch.t, batch.flags, batch.x, 0 * batch.u)
    tubes = engine.step(nothing)
    assert_holds(tubes, 0, drive.truth[NOW + 1 : NOW + 11])


def test_calibrated_tubes_wait_for_their_lagged_increments() -> None:
    """A car that is set down elsewhere has no increments yet: those of the jump would give a wild prediction."""
    spec = SMALL.model_dump(by_alias=True, exclude_none=True)
    spec |= {"input_lags": 0, "confidence": 0.9, "horizon": 2}
    del spec["lipschitz"]
    engine = engine_of(parse_profile(spec), method="calibrated", planned=False)
    drive = history(2)
    engine.append(samples_of(drive, 0, NOW))
    moved = samples_of(drive, NOW, NOW + 3)
    flags = moved.flags.copy()
    flags[0] = int(StateFlag.NEW_TRAJECTORY)
    jumped = SampleBatch(
        moved.vehicle, moved.epoch, moved.seq, moved.t, flags, moved.x + np.array([50, 0, 0, 0]), moved.u
    )
    for k in range(2):
        assert engine.step(jumped.take(np.array([k]))).waiting
    tubes = engine.step(jumped.take(np.array([2])))
    assert tubes.labels == (Label.CALIBRATED,)
    assert tubes.area[0, 0] < 0.05
    assert "learned driver" in tubes.notes[0]


def test_without_a_model_limits_alone_say_where_a_vehicle_can_be() -> None:
    drive = history(3)
    spec = PROFILE.model_dump(by_alias=True, exclude_none=True) | {"window": 150}
    spec["state"]["yaw"] |= {"rate": 8.0}
    spec["state"]["v"] |= {"limits": [-2.0, 2.0], "rate": 20.0}
    engine = engine_of(parse_profile(spec))
    few, many = samples_of(drive, 0, 6), samples_of(drive, 0, NOW, 1)
    engine.add("car-1")
    engine.append(many)
    tubes = engine.step(SampleBatch.join([few, samples_of(drive, NOW, NOW + 1, 1)]))
    by_name = dict(zip(tubes.vehicles, range(2), strict=True))
    row = by_name["car-0"]
    assert (tubes.methods[row], tubes.labels[row]) == ("limits", Label.GUARANTEED)
    assert (tubes.methods[by_name["car-1"]], tubes.labels[by_name["car-1"]]) == ("set_membership", Label.GUARANTEED)
    assert tubes.notes[row] == ("from limits alone, too few samples for set_membership: at least 13 more",)
    assert not tubes.waiting
    assert_holds(tubes, row, drive.truth[6:16])
    alone = engine_of(parse_profile(spec)).step(few)
    np.testing.assert_array_equal(alone.area[0], tubes.area[row])
    nothing = engine_of(SMALL).step(few)
    assert nothing.waiting == {"car-0": "too few samples for set_membership: at least 13 more"}


def test_linear_models_begin_anew_with_the_window() -> None:
    """An agent whose clock was set back comes with an older epoch, and its window begins anew."""
    system = linear(500, 2, window=60)
    engine = Engine(system.profile, method="lti")
    engine.add("vehicle")
    for k in range(200):
        engine.append(system.batch(1, k))
    assert engine.predict(np.array([0]), PlannedInputs(system.plan(1, 199), np.zeros((1, 2)))).vehicles
    engine.window.clear(0)
    for k in range(200, 300):
        engine.append(system.batch(1, k))
    fresh = Engine(system.profile, method="lti")
    fresh.add("vehicle")
    for k in range(200, 300):
        fresh.append(system.batch(1, k))
    known = PlannedInputs(system.plan(1, 299), np.zeros((1, 2)))
    tubes, wanted = (one.predict(np.array([0]), known) for one in (engine, fresh))
    np.testing.assert_array_equal(tubes.area, wanted.area)


def test_a_vehicle_without_a_model_waits_while_others_are_served() -> None:
    engine = engine_of(SMALL, 3)
    engine.append(samples_of(history(1), 0, NOW, 1))
    few, enough = samples_of(history(0), 0, 6), samples_of(history(1), NOW, NOW + 1, 1)
    wild = samples_of(history(2), 0, NOW, 2)
    huge = SampleBatch(wild.vehicle, wild.epoch, wild.seq, wild.t, wild.flags, 1e29 * wild.x, wild.u)
    tubes = engine.step(SampleBatch.join([few, enough, huge]))
    assert "car-1" in tubes.vehicles
    assert set(tubes.vehicles) | set(tubes.waiting) == {"car-0", "car-1", "car-2"}
    alone = engine_of(SMALL)
    alone.append(samples_of(history(1), 0, NOW))
    (area,) = alone.step(samples_of(history(1), NOW, NOW + 1)).area
    np.testing.assert_array_equal(tubes.area[tubes.vehicles.index("car-1")], area)
