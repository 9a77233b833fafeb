"""The engine on simulated cars: true states stay in the tubes, and what contradicts them is told."""

import numpy as np
import pytest

from fleet_bus.errors import UsageError
from fleet_bus.messages import Audit, Label, parse_profile
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine
from reach_server.service.tube_messages import messages
from tests.reach_server.drives import PROFILE, START, SVEA, block_of, history, samples_of
from tests.reach_server.engine.engines import (
    NOW,
    SMALL,
    assert_finite,
    assert_holds,
    box_scenario,
    close_to,
    engine_of,
    plan_of,
)
from tests.reach_server.ugly import assert_outlines


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
