"""The engine on simulated cars: true states stay in the tubes, and what contradicts them is told."""

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
import pytest

from fleet_bus.errors import UsageError
from fleet_bus.messages import Audit, EventKind, Label, StateFlag, VehicleProfile, parse_profile
from fleet_lab.fleets import linear
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine, PlannedInputs
from reach_server.engine.results import Tubes
from reach_server.numeric.types import FloatArray
from reach_server.service.tube_messages import messages
from side_info import Scenario
from tests.reach_server.drives import PROFILE, START, SVEA, block_of, history, inside, samples_of
from tests.reach_server.ugly import assert_outlines
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


@pytest.mark.parametrize("method", ["set_membership", "residual_hull"])
@pytest.mark.parametrize("planned", [True, False])
def test_true_states_stay_in_guaranteed_tubes(method: str, planned: bool) -> None:
    drives = [history(seed) for seed in range(3)]
    engine = engine_of(SMALL, 3, method=method)
    engine.append(SampleBatch.join([samples_of(d, 0, NOW, slot) for slot, d in enumerate(drives)]))
    for k in range(NOW + 6, 405, 7):
        batch = SampleBatch.join([samples_of(d, k - 6, k + 1, slot) for slot, d in enumerate(drives)])
        tubes = engine.step(batch, plan_of(drives, k) if planned else None)
        assert tubes.labels == (Label.GUARANTEED,) * 3
        assert not tubes.events
        for slot, d in enumerate(drives):
            assert_holds(tubes, slot, d.truth[k + 1 : k + 11])
        assert [engine.audit_of(vehicle).inside for vehicle in engine.vehicles] == [(k - NOW - 6) // 7] * 3


def test_every_one_step_prediction_is_audited_and_holds() -> None:
    drive = history(4)
    engine = engine_of()
    engine.append(samples_of(drive, 0, NOW))
    for k in range(NOW, NOW + 25):
        assert not engine.step(samples_of(drive, k, k + 1), plan_of([drive], k)).events
    assert engine.audit_of("car-0") == Audit(24, 24, 0.0, 24, 24, 0)


@pytest.mark.parametrize("cuts", ["zonotope", "constrained", "frobenius"])
def test_true_states_stay_in_the_cut_tubes_and_in_what_is_published(cuts: str) -> None:
    drive = history(0)
    truth = drive.truth[NOW + 1 : NOW + 11]
    low, high = drive.truth[NOW : NOW + 11, :2].min(axis=0) - 0.01, drive.truth[NOW : NOW + 11, :2].max(axis=0) + 0.01
    engine = engine_of(SMALL.model_copy(update={"cuts": cuts}), 2)
    engine.append(samples_of(drive, 0, NOW))
    engine.append(samples_of(history(1), 0, NOW, 1))
    engine.assign("car-0", box_scenario(low, high), START + NOW * SVEA.dt_ns)
    batch = SampleBatch.join([samples_of(drive, NOW, NOW + 1), samples_of(history(1), NOW, NOW + 1, 1)])
    tubes = engine.step(batch)
    assert not tubes.events
    assert tubes.cuts[0]
    assert not tubes.cuts[1]
    assert_holds(tubes, 0, truth)
    assert (tubes.area[0, -1] < 0.2 * tubes.area_free[0, -1]).all()
    np.testing.assert_array_equal(tubes.area[1], tubes.area_free[1])
    audits = [Audit(), Audit()]
    message = next(messages(tubes, SMALL.state_names, (0, 1), audits, server="s", server_epoch=1, compute_seconds=0.1))
    sent = type(message).decode(message.encode())
    for k in range(10):
        point = close_to(truth[k : k + 1], sent.center[k])[0] - sent.center[k]
        assert_outlines(sent.outline[k], point[None, :2], 1.0)
        assert (sent.hull[k, 0] <= point).all()
        assert (point <= sent.hull[k, 1]).all()
        assert (np.abs(point) <= np.abs(sent.generators[k]).sum(axis=1)).all()


def test_a_vehicle_that_leaves_its_scenario_is_told_and_no_longer_cut() -> None:
    drive = history(0)
    engine = engine_of()
    engine.append(samples_of(drive, 0, NOW))
    here = drive.truth[NOW, :2]
    engine.assign("car-0", box_scenario(here - 0.05, here + 0.05), START + NOW * SVEA.dt_ns)
    found = []
    for k in range(NOW, NOW + 40):
        tubes = engine.step(samples_of(drive, k, k + 1), plan_of([drive], k))
        found += [event for event in tubes.events if event.kind is EventKind.CONTRADICTION]
        if found:
            assert_holds(tubes, 0, drive.truth[k + 1 : k + 11])
            np.testing.assert_array_equal(tubes.area, tubes.area_free)
            assert not tubes.cuts[0]
            assert "side information contradicted" in tubes.notes[0]
    assert len(found) == 1
    assert found[0].details["scenario"] == "box"
    # A wrong scenario says nothing about the stated bounds.
    assert tubes.labels == (Label.GUARANTEED,)


def test_a_measured_state_outside_of_its_set_contradicts_the_bounds() -> None:
    drive = history(2)
    engine = engine_of()
    engine.append(samples_of(drive, 0, NOW))
    engine.step(samples_of(drive, NOW, NOW + 1), plan_of([drive], NOW))
    batch = samples_of(drive, NOW + 1, NOW + 2)
    jumped = SampleBatch(
        batch.vehicle, batch.epoch, batch.seq, batch.t, batch.flags, batch.x + np.array([0.5, 0, 0, 0]), batch.u
    )
    tubes = engine.step(jumped, plan_of([drive], NOW + 1))
    assert [event.kind for event in tubes.events] == [EventKind.MISS]
    assert 0.3 < tubes.events[0].details["excess"] < 0.5
    assert tubes.labels == (Label.CONTRADICTED,)
    audit = engine.audit_of("car-0")
    assert (audit.checked, audit.inside) == (1, 0)
    assert audit.last_miss == tubes.events[0].details["excess"]
    later = engine.step(samples_of(drive, NOW + 2, NOW + 3), plan_of([drive], NOW + 2))
    assert later.labels == (Label.CONTRADICTED,)


def test_data_that_excludes_the_bounds_is_told_once() -> None:
    fields = SMALL.model_dump(by_alias=True, exclude_none=True)
    fields["lipschitz"] = {"matrix": np.full((4, 7), 1e-6).tolist(), "of": "residual", "origin": "given"}
    fields["noise"]["process"]["box"] = [1e-6] * 4
    fields["noise"]["measurement"]["box"] = [1e-6] * 4
    engine = engine_of(parse_profile(fields))
    drive = history(2)
    engine.append(samples_of(drive, 0, NOW))
    kinds = []
    for k in range(NOW, NOW + 3):
        tubes = engine.step(samples_of(drive, k, k + 1), plan_of([drive], k))
        kinds += [event.kind for event in tubes.events]
        assert tubes.labels == (Label.CONTRADICTED,)
    assert kinds.count(EventKind.DATA_CONTRADICTED) == 1


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


def assert_finite(tubes: Tubes) -> None:
    arrays = [tubes.area, tubes.area_free, tubes.outline, tubes.hull]
    for sets in (*tubes.steps, *tubes.free):
        arrays += [getattr(sets, f.name) for f in fields(sets)]
    assert all(np.isfinite(array).all() for array in arrays)
    assert (tubes.area >= 0).all()
    assert (tubes.hull[:, :, 0] <= tubes.hull[:, :, 1]).all()


@pytest.mark.parametrize("cuts", ["zonotope", "constrained", "frobenius"])
@pytest.mark.parametrize("method", ["set_membership", "residual_hull", "paper", "calibrated"])
def test_no_result_holds_nan(method: str, cuts: str) -> None:
    """Three cars: one that drives, one that stands, one whose every number is the same."""
    profile = SMALL.model_copy(update={"cuts": cuts, "confidence": 0.9, "horizon": 4, "window": 200})
    drive = history(0)
    stands = samples_of(drive, 0, NOW, 1)
    stuck = samples_of(drive, 0, NOW, 2)
    rng = np.random.default_rng(0)
    noise = 1e-3 * rng.uniform(-1, 1, stands.x.shape)
    batch = SampleBatch.join([
        samples_of(drive, 0, NOW),
        SampleBatch(stands.vehicle, stands.epoch, stands.seq, stands.t, stands.flags, noise, 0 * stands.u),
        SampleBatch(stuck.vehicle, stuck.epoch, stuck.seq, stuck.t, stuck.flags, 0 * stuck.x + 1.0, 0 * stuck.u),
    ])  # fmt: skip
    engine = engine_of(profile, 3, method=method, planned=False)
    here = drive.truth[NOW, :2]
    engine.assign("car-0", box_scenario(here - 0.3, here + 0.3), START)
    engine.assign("car-1", box_scenario(np.full(2, -0.02), np.full(2, 0.02), "parked"), START)
    tubes = engine.step(batch)
    assert set(tubes.vehicles) | set(tubes.waiting) == {"car-0", "car-1", "car-2"}
    assert "car-0" in tubes.vehicles
    assert_finite(tubes)
    if cuts != "frobenius":
        assert (tubes.area <= tubes.area_free * (1 + 1e-9) + 1e-12).all()
    if method != "calibrated":
        assert all("rank deficient" in tubes.notes[tubes.vehicles.index(name)] for name in ("car-1", "car-2"))


@pytest.mark.parametrize("cuts", ["zonotope", "frobenius"])
@pytest.mark.parametrize("method", ["calibrated", "set_membership", "residual_hull", "paper"])
def test_equal_data_gives_equal_sets_whatever_else_is_in_the_batch(method: str, cuts: str) -> None:
    """To the last bit: among others, in another order, with another slot, in other portions."""
    profile = SMALL.model_copy(update={"cuts": cuts, "confidence": 0.9, "window": 250})
    drives = [history(seed) for seed in (0, 1, 0, 2)]
    here = drives[0].truth[NOW : NOW + 40, :2]
    boxes = box_scenario(here.min(axis=0) - 0.02, here.max(axis=0) + 0.02)
    alone, crowd = engine_of(profile, method=method), engine_of(profile, 4, method=method)
    alone.append(samples_of(drives[0], 0, NOW))
    for first in range(0, NOW, 60):
        last = min(first + 60, NOW)
        crowd.append(SampleBatch.join([samples_of(drives[i], first, last, i) for i in (3, 2, 1, 0)]))
    for slot in (0, 2):
        crowd.assign(f"car-{slot}", boxes, START + NOW * SVEA.dt_ns)
    crowd.assign("car-3", box_scenario(np.full(2, -99.0), np.full(2, 99.0), "other"), START)
    alone.assign("car-0", boxes, START + NOW * SVEA.dt_ns)
    cut = 0
    for k in range(NOW, NOW + 25):
        one = alone.step(samples_of(drives[0], k, k + 1), plan_of([drives[0]], k))
        together = SampleBatch.join([samples_of(drives[i], k, k + 1, i) for i in (2, 0, 3, 1)])
        tubes = crowd.step(together, plan_of(drives, k))
        for row in (tubes.vehicles.index("car-0"), tubes.vehicles.index("car-2")):
            for name in ("area", "area_free", "outline", "hull"):
                np.testing.assert_array_equal(getattr(tubes, name)[row], getattr(one, name)[0])
            for mine, theirs in zip(one.steps, tubes.steps, strict=True):
                np.testing.assert_array_equal(mine.center[0], theirs.center[row])
            assert (tubes.cuts[row], tubes.labels[row]) == (one.cuts[0], one.labels[0])
        cut += bool(one.cuts[0])
    assert cut


def test_a_sample_that_comes_twice_counts_once() -> None:
    drive = history(2)
    engine = engine_of()
    engine.append(samples_of(drive, 0, NOW))
    engine.step(samples_of(drive, NOW, NOW + 1), plan_of([drive], NOW))
    one = samples_of(drive, NOW + 1, NOW + 2)
    tubes = engine.step(SampleBatch.join([one, one]), plan_of([drive], NOW + 1))
    assert tubes.vehicles == ("car-0",)
    assert engine.audit_of("car-0") == Audit(1, 1, 0.0, 1, 1, 0)
    engine.append(one)
    assert engine.audit_of("car-0") == Audit(1, 1, 0.0, 1, 1, 0)


@pytest.mark.parametrize("change", ["gap", "epoch", "trajectory", "late"])
def test_a_sample_that_does_not_follow_is_not_held_against_the_prediction(change: str) -> None:
    drive = history(2)
    engine = engine_of()
    engine.append(samples_of(drive, 0, NOW))
    engine.step(samples_of(drive, NOW, NOW + 1))
    flags = StateFlag.NEW_TRAJECTORY if change == "trajectory" else StateFlag.NONE
    after = samples_of(drive, NOW + 1, NOW + 2, epoch=2 if change == "epoch" else 1, flags=flags)
    late = SVEA.dt_ns if change == "late" else 0
    skipped = np.uint64(change == "gap")
    engine.append(
        SampleBatch(after.vehicle, after.epoch, after.seq + skipped, after.t + late, after.flags, after.x + 9, after.u)
    )
    assert engine.audit_of("car-0") == Audit()


def test_reset_forgets_samples_model_and_record() -> None:
    drive = history(2)
    engine = engine_of()
    for k in (NOW, NOW + 1):
        engine.append(samples_of(drive, 0 if k == NOW else k, k + 1))
        engine.predict(np.array([0]))
    assert engine.audit_of("car-0").checked == 1
    engine.reset("car-0")
    assert engine.audit_of("car-0") == Audit()
    assert engine.window_filled()[0] == 0
    tubes = engine.step(samples_of(drive, NOW + 2, NOW + 8))
    assert "too few" in tubes.waiting["car-0"]


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


def test_calibrated_tubes_hold_most_measured_states() -> None:
    profile = SMALL.model_copy(update={"confidence": 0.9, "window": 250, "horizon": 3})
    drives = [history(seed) for seed in range(12)]
    engine = engine_of(profile, 12, method="calibrated", planned=False)
    engine.append(SampleBatch.join([samples_of(d, 0, NOW, slot) for slot, d in enumerate(drives)]))
    claimed = 0
    for k in range(NOW, NOW + 80):
        tubes = engine.step(SampleBatch.join([samples_of(d, k, k + 1, slot) for slot, d in enumerate(drives)]))
        assert not tubes.events
        outside = [any(note.startswith("outside the data") for note in notes) for notes in tubes.notes]
        assert [label is Label.UNCOVERED for label in tubes.labels] == outside
        claimed += 12 - sum(outside) if k < NOW + 79 else 0
    audits = [engine.audit_of(f"car-{slot}") for slot in range(12)]
    rate = sum(a.inside for a in audits) / sum(a.checked for a in audits)
    # What is outside the data is not held against the confidence.
    assert 12 * 75 < sum(a.checked for a in audits) == claimed
    assert 0.8 < rate < 0.99


def test_cuts_of_calibrated_sets_leave_room_for_the_measurement_noise() -> None:
    """A calibrated set speaks about measured states, the scenario about true ones."""
    assert SMALL.noise.measurement is not None
    noise_half = np.abs(SMALL.noise.measurement.matrix()).sum(axis=1)[:2]
    drive = history(0)
    there = drive.truth[NOW + 10, :2]
    low, high = there - 0.4, there + 1e-3
    last = f"{10 * SVEA.dt}:{10 * SVEA.dt} s"
    for method, room in (("calibrated", noise_half), ("set_membership", np.zeros(2))):
        engine = engine_of(SMALL.model_copy(update={"confidence": 0.9}), method=method, planned=False)
        engine.append(samples_of(drive, 0, NOW))
        engine.assign("car-0", box_scenario(low, high, window=last), START + NOW * SVEA.dt_ns)
        tubes = engine.step(samples_of(drive, NOW, NOW + 1))
        assert tubes.cuts[0]
        upper = tubes.steps[-1].center[0, :2] + tubes.hull[0, -1, 1, :2]
        np.testing.assert_allclose(upper, high + room, atol=1e-4)


def test_labels_say_what_the_bounds_allow() -> None:
    spec = PROFILE.model_dump(by_alias=True, exclude_none=True) | {"window": 150}
    fitted = {**spec, "lipschitz": {**spec["lipschitz"], "origin": "calibrated"}}
    missing = {name: value for name, value in spec.items() if name != "lipschitz"}
    drive = history(1)
    for fields_of, method, label in (
        (spec, None, Label.GUARANTEED),
        (fitted, "set_membership", Label.CALIBRATED),
        (missing, "residual_hull", Label.UNCOVERED),
        (spec, "paper", Label.UNCOVERED),
    ):
        engine = engine_of(parse_profile(fields_of), method=method)
        tubes = engine.step(samples_of(drive, 0, NOW))
        assert tubes.labels == (label,)
    assert engine_of(parse_profile(fitted | {"window": 1000})).method == "calibrated"


def test_unknown_methods_are_refused() -> None:
    with pytest.raises(UsageError, match="magic"):
        Engine(PROFILE, method="magic")


def test_tubes_are_dated_from_the_newest_sample() -> None:
    drive = history(1)
    engine = engine_of()
    tubes = engine.step(samples_of(drive, 0, NOW))
    assert int(tubes.seq[0]) == NOW - 1
    np.testing.assert_array_equal(tubes.times[0], START + (NOW - 1 + np.arange(1, 11)) * SVEA.dt_ns)
    assert block_of(drive.measured[:3], drive.inputs[:3]).x.shape == (1, 3, 4)


def test_what_was_recorded_before_the_start_contradicts_nothing() -> None:
    """A scenario with a time zero of its own does not judge what the agent brought along."""
    drive = history(2)
    engine = engine_of()
    engine.append(samples_of(drive, 0, NOW, flags=StateFlag.HISTORY))
    there = drive.truth[NOW, :2]
    side = Scenario.parse(
        "scenario: now\nversion: 1\nstate: {x1: m, x2: m}\ntime: {zero: '2001-09-09T01:46:40Z'}\n"
        f"assume: 'always[0:100 s](norm(x1 - {there[0]}, x2 - {there[1]}) <= 0.5)'\n"
    )
    assert (np.linalg.norm(drive.truth[:NOW, :2] - there, axis=1) > 1).any()
    engine.assign("car-0", side, START)
    assert not engine.step(samples_of(drive, NOW, NOW + 1), plan_of([drive], NOW)).events


def test_a_document_that_mends_another_is_not_blamed_for_it() -> None:
    drive = history(3)
    engine = engine_of()
    engine.append(samples_of(drive, 0, NOW))
    there = drive.truth[NOW + 1, :2]
    engine.assign("car-0", box_scenario(there - 9, there - 0.01, window="0.05:0.05 s"), START + NOW * SVEA.dt_ns)
    engine.step(samples_of(drive, NOW, NOW + 1), plan_of([drive], NOW))
    engine.assign("car-0", box_scenario(there - 99, there + 99), START + NOW * SVEA.dt_ns)
    assert not engine.step(samples_of(drive, NOW + 1, NOW + 2), plan_of([drive], NOW + 1)).events


def test_filtering_leaves_true_states_inside_and_sets_no_larger() -> None:
    drive = history(2)
    # Measured far less exactly than is assumed of the dynamics.
    noise = {"process": {"box": [1e-3] * 4, "origin": "given"}, "measurement": {"box": [0.2] * 4, "origin": "given"}}
    spec = PROFILE.model_dump(by_alias=True, exclude_none=True) | {"window": 150, "noise": noise}
    areas: list[list[float]] = [[], []]
    for filtered in (False, True):
        engine = engine_of(parse_profile(spec | {"filtered": filtered}))
        engine.append(samples_of(drive, 0, NOW))
        for k in range(NOW, NOW + 25):
            tubes = engine.step(samples_of(drive, k, k + 1), plan_of([drive], k))
            assert not tubes.events
            assert_holds(tubes, 0, drive.truth[k + 1 : k + 11])
            areas[filtered].append(float(tubes.area[0, 0]))
    # The first tube has no prediction before it.
    assert areas[0][0] == areas[1][0]
    assert np.mean(areas[1]) <= np.mean(areas[0])


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


def test_frozen_engines_learn_nothing_more() -> None:
    drive = history(1)
    engine, frozen = engine_of(), engine_of()
    for one in (engine, frozen):
        one.append(samples_of(drive, 0, 200))
    frozen.frozen = True
    for k in range(200, 330):
        tubes, other = (e.step(samples_of(drive, k, k + 1), plan_of([drive], k)) for e in (engine, frozen))
        assert_holds(other, 0, drive.truth[k + 1 : k + 11])
    assert (tubes.area != other.area).any()


@pytest.mark.parametrize("value", [1e31, np.nan, -np.inf])
def test_a_sample_that_is_refused_says_nothing_about_a_set(value: float) -> None:
    drive = history(1)
    engine = engine_of()
    engine.append(samples_of(drive, 0, NOW))
    engine.step(samples_of(drive, NOW, NOW + 1), plan_of([drive], NOW))
    wrong = samples_of(drive, NOW + 1, NOW + 2)
    wrong.x[0, 0] = value
    appended, events = engine.append(wrong)
    assert (appended.stored, appended.not_finite, events) == (0, 1, ())
    assert engine.audit_of("car-0").checked == 0
    tubes = engine.step(samples_of(drive, NOW + 2, NOW + 6), plan_of([drive], NOW + 5))
    assert tubes.labels == (Label.GUARANTEED,)


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
