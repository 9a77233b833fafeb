"""What contradicts bounds and scenarios is told, and nothing else is held against them."""

import numpy as np
import pytest

from fleet_bus.messages import Audit, EventKind, Label, StateFlag, parse_profile
from reach_server.data.window import SampleBatch
from side_info import Scenario
from tests.reach_server.drives import PROFILE, START, SVEA, history, samples_of
from tests.reach_server.engine.engines import NOW, SMALL, assert_holds, box_scenario, engine_of, plan_of


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
