"""What a wrong pose costs: nothing is judged by a jump, real violations falsify, and labels come back."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from fleet_bus.messages import EventKind, Label, VehicleProfile, parse_profile
from reach_server.audit.coverage import FORGIVEN
from reach_server.audit.prediction_check import RECENT
from reach_server.data.stream_order import LATE_BATCHES, RESYNC
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine, PlannedInputs
from reach_server.numeric.types import FloatArray
from tests.reach_server.drives import PROFILE, START, SVEA, history, inside, samples_of
from tests.reach_server.engine.engines import box_scenario, close_to
from vehicle_agent.simulate import Drive

SMALL = PROFILE.model_copy(update={"window": 120, "horizon": 2})
LAGS = SMALL.input_lags
BEGIN, BAD, END = 200, 250, 380
NOISE = np.abs(PROFILE.noise.measurement.matrix()).sum(axis=1) if PROFILE.noise.measurement else np.zeros(4)
FALSE = (EventKind.MISS, EventKind.DATA_CONTRADICTED)


@dataclass
class Story:
    """Labels by sample, None where there was no tube, and events (sample, kind)."""

    engine: Engine
    labels: dict[int, Label | None] = field(default_factory=dict)
    events: list[tuple[int, EventKind]] = field(default_factory=list)

    def kinds(self, *wanted: EventKind) -> list[int]:
        return [k for k, kind in self.events if kind in wanted]

    def go_on(self, drive: Drive, offset: FloatArray, begin: int, end: int, truth: FloatArray | None = None) -> None:
        measured = replace(drive, measured=drive.measured + offset)
        steps = self.engine.horizon
        for k in range(begin, end):
            known = PlannedInputs(drive.inputs[None, k + 1 : k + steps], np.zeros((1, drive.inputs.shape[1])))
            tubes = self.engine.step(samples_of(measured, k, k + 1), known)
            self.labels[k] = tubes.labels[0] if tubes.labels else None
            self.events += [(k, event.kind) for event in tubes.events]
            if truth is not None and self.labels[k] is Label.GUARANTEED:
                for h, sets in enumerate(tubes.steps, 1):
                    point = close_to(truth[[k + h]], sets.center[0])
                    assert inside(sets, 0, point, np.random.default_rng(0), 8).all(), (k, h)


def story(profile: VehicleProfile = SMALL, **options: str) -> Story:
    engine = Engine(profile, **options)  # type: ignore[arg-type]
    engine.add("car")
    return Story(engine)


def told(offset: FloatArray, truth: FloatArray | None = None, profile: VehicleProfile = SMALL, **options: str) -> Story:
    """A drive of which what is measured is off from sample ``BEGIN`` on."""
    drive, made = history(2), story(profile, **options)
    made.engine.append(samples_of(drive, 0, BEGIN))
    made.go_on(drive, offset, BEGIN, END, truth)
    return made


def off(change: float, at: slice) -> FloatArray:
    offset = np.zeros((len(history(2).truth), 4))
    offset[at, 0] = change
    return offset


def test_one_bad_pose_costs_no_label_and_bears_no_tube() -> None:
    made = told(off(3.0, slice(BAD, BAD + 1)), history(2).truth)
    assert made.events == [(BAD, EventKind.JUMP), (BAD + 1, EventKind.JUMP)]
    without = [k for k, label in made.labels.items() if label is None]
    assert without == list(range(BAD, BAD + 1 + LAGS))
    assert {label for k, label in made.labels.items() if k not in without} == {Label.GUARANTEED}
    audit = made.engine.audit_of("car")
    assert audit.checked == audit.inside


def test_a_car_that_was_carried_has_its_label_where_it_stands_now() -> None:
    offset = off(3.0, slice(BAD, None))
    made, drive = story(), history(2)
    made.engine.append(samples_of(drive, 0, BEGIN))
    # Being carried is no motion that a tube speaks about: those before end with it.
    made.go_on(drive, offset, BEGIN, BAD)
    made.go_on(drive, offset, BAD, END, drive.truth + offset)
    assert made.events == [(BAD, EventKind.JUMP)]
    assert [k for k, label in made.labels.items() if label is None] == list(range(BAD, BAD + LAGS))
    assert made.labels[BAD + LAGS] is made.labels[END - 1] is Label.GUARANTEED


@pytest.mark.parametrize("factor", [1.5, 2.0, 3.0, 5.0])
def test_a_noise_bound_that_is_false_falsifies(factor: float) -> None:
    drive, rng = history(2), np.random.default_rng(0)
    offset = drive.truth - drive.measured + factor * NOISE * rng.choice([-1.0, 1.0], drive.truth.shape)
    offset[:BEGIN] = 0.0
    made = told(offset)
    first = made.kinds(*FALSE)[0]
    assert first < BEGIN + 40
    assert {made.labels[k] for k in range(first, END)} == {Label.CONTRADICTED}


@pytest.mark.parametrize(("factor", "excused"), [(3.5, False), (4.9, False), (40.0, True)])
@pytest.mark.slow
def test_what_a_bound_wrong_by_a_small_factor_explains_is_no_excuse(factor: float, excused: bool) -> None:
    """Where the noise is large against the motion a pose may jump by the window's rule: that alone excuses nothing."""
    error = 0.05
    profile = parse_profile(
        {
            "class": "slow",
            "state": {"a": {"unit": "m", "rate": 0.1}}, "inputs": {"u": {"unit": "m", "limits": [-1, 1]}},
            "sample_time": 0.05, "window": 60, "horizon": 2, "future_inputs": "limits", "method": "set_membership",
            "noise": {
                "process": {"box": [1e-4], "origin": "given"}, "measurement": {"box": [error], "origin": "given"},
            },
            "lipschitz": {"lower": [[0.9, 0.0]], "upper": [[1.0, 0.002]], "origin": "given"},
        }
    )  # fmt: skip
    rng = np.random.default_rng(1)
    u, truth = rng.uniform(-1, 1, (300, 1)), np.zeros((300, 1))
    for k in range(299):
        truth[k + 1] = 0.95 * truth[k] + 0.001 * u[k]
    measured = truth + rng.uniform(-error, error, truth.shape)
    measured[BAD] = truth[BAD] + factor * error
    made = story(profile)
    for k in range(300):
        one = SampleBatch(
            np.zeros(1, dtype=np.intp), np.ones(1, dtype=np.uint64), np.array([k], dtype=np.uint64),
            np.array([START + k * profile.sample_time_ns]), np.zeros(1, dtype=np.uint32), measured[[k]], u[[k]],
        )  # fmt: skip
        tubes = made.engine.step(one)
        made.events += [(k, event.kind) for event in tubes.events]
        made.labels[k] = tubes.labels[0] if tubes.labels else None
    assert BAD in made.kinds(EventKind.JUMP)
    assert made.kinds(*FALSE) == ([] if excused else [BAD])
    assert made.labels[BAD + 3] is (Label.GUARANTEED if excused else Label.CONTRADICTED)


@pytest.mark.parametrize(("drift", "seen"), [(0.002, False), (0.05, True)])
def test_a_drift_is_no_jump(drift: float, seen: bool) -> None:
    """One within the bounds nobody sees; one beyond them is a miss."""
    offset = off(0.0, slice(None))
    offset[BAD:, 0] = drift * np.arange(len(offset) - BAD)
    made = told(offset)
    assert not made.kinds(EventKind.JUMP)
    assert bool(made.kinds(*FALSE)) is seen
    assert made.labels[END - 1] is (Label.CONTRADICTED if seen else Label.GUARANTEED)


@pytest.mark.slow
def test_jumps_that_repeat_cost_the_label_as_long_as_they_do() -> None:
    count = 2 * RECENT
    drive, made = history(5, count), story()
    made.engine.append(samples_of(drive, 0, BEGIN))
    offset = np.zeros((count, 4))
    bad = [BAD, BAD + 100, BAD + 200, BAD + 300]
    offset[bad, 0] = 3.0
    made.go_on(drive, offset, BEGIN, count - 2)
    assert made.kinds(EventKind.JUMP) == sorted(k + i for k in bad for i in (0, 1))
    assert not made.kinds(*FALSE)
    labels = made.labels
    assert labels[bad[1] - 1] is Label.GUARANTEED, f"{FORGIVEN} jumps, there and back, are forgiven"
    assert {labels[k] for k in range(bad[1] + 1, bad[3] + RECENT - 100)} == {Label.CONTRADICTED, None}
    # Of the last jumps no more than two are left among the newest checks.
    assert labels[bad[3] + RECENT + 50] is Label.GUARANTEED


@pytest.mark.slow
def test_a_refuted_bound_is_believed_again_when_its_window_has_passed() -> None:
    count = 1400
    drive, made = history(5, count), story(SMALL.model_copy(update={"window": 60}))
    span = made.engine.window.size
    made.engine.append(samples_of(drive, 0, BEGIN))
    offset = np.zeros((count, 4))
    second = BAD + 3 * span
    offset[[BAD, second], 0] = 0.4
    made.go_on(drive, offset, BEGIN, count - 2, drive.truth)
    wrong = made.kinds(*FALSE)
    first = [k for k in wrong if k < second]
    assert first[0] == BAD
    back = made.kinds(EventKind.COVERAGE)
    assert len(back) == 2
    assert back[0] == first[-1] + span
    assert {made.labels[k] for k in range(BAD, back[0])} == {Label.CONTRADICTED}
    assert {made.labels[k] for k in range(back[0], second)} == {Label.GUARANTEED}
    # A bound that is refuted once more is believed after twice as long.
    # What excludes the bounds counts for as long as the window holds it.
    assert wrong[-1] + 2 * span <= back[1] <= wrong[-1] + 3 * span
    assert {made.labels[k] for k in range(second, back[1])} == {Label.CONTRADICTED}
    audit = made.engine.audit_of("car")
    assert audit.checked - audit.inside >= 2, "what was missed stays on record"


def test_a_jump_is_a_miss_of_a_calibrated_rate_and_no_more() -> None:
    spec = SMALL.model_dump(by_alias=True, exclude_none=True) | {"confidence": 0.95}
    made = told(off(3.0, slice(BAD, BAD + 1)), profile=parse_profile(spec), method="calibrated")
    assert BAD in made.kinds(EventKind.JUMP)
    audit = made.engine.audit_of("car")
    assert audit.checked > audit.inside
    assert made.labels[END - 1] is Label.CALIBRATED
    assert not made.kinds(*FALSE, EventKind.COVERAGE)


def test_many_glitches_are_too_many_misses_of_a_calibrated_rate() -> None:
    spec = SMALL.model_dump(by_alias=True, exclude_none=True) | {"confidence": 0.95}
    made = told(off(3.0, slice(BAD, None, 6)), profile=parse_profile(spec), method="calibrated")
    assert made.kinds(EventKind.COVERAGE)
    assert made.labels[max(k for k, label in made.labels.items() if label is not None)] is Label.CONTRADICTED


@pytest.mark.parametrize(("stays", "contradicted"), [(False, []), (True, [BAD + 1])])
def test_a_scenario_is_judged_by_a_pose_that_another_one_confirms(stays: bool, contradicted: list[int]) -> None:
    drive, made = history(2), story()
    made.engine.append(samples_of(drive, 0, BEGIN))
    way = drive.truth[BEGIN:END, :2]
    made.engine.assign("car", box_scenario(way.min(axis=0) - 0.2, way.max(axis=0) + 0.2), START + BEGIN * SVEA.dt_ns)
    made.go_on(drive, off(9.0, slice(BAD, None if stays else BAD + 1)), BEGIN, END)
    assert made.kinds(EventKind.CONTRADICTION) == contradicted


def spoiled(batch: SampleBatch, **numbers: int) -> SampleBatch:
    """One sample with other numbers of its header."""
    one = replace(batch, epoch=batch.epoch.copy(), seq=batch.seq.copy(), t=batch.t.copy())
    for name, value in numbers.items():
        getattr(one, name)[0] = value
    return one


HOUR = 3600 * 10**9
LEAPS = [
    {"seq": 2**64 - 1}, {"seq": BAD + 10**6}, {"epoch": 2**63}, {"t": 2**63 - 1},
    {"t": START + BAD * SVEA.dt_ns + HOUR}, {"epoch": 2**63, "t": 2**62}, {"seq": 2**40, "epoch": 2**64 - 1, "t": 1},
]  # fmt: skip


@pytest.mark.parametrize("numbers", LEAPS)
def test_a_leap_is_refused_told_once_and_bears_no_tube(numbers: dict[str, int]) -> None:
    drive, made = history(2), story()
    made.engine.append(samples_of(drive, 0, BEGIN))
    none = off(0.0, slice(None))
    made.go_on(drive, none, BEGIN, BAD)
    for _ in range(2):
        appended, events = made.engine.append(spoiled(samples_of(drive, BAD, BAD + 1), **numbers))
        assert (appended.stored, appended.leaped) == (0, 1)
        made.events += [(BAD, event.kind) for event in events]
    made.go_on(drive, none, BAD, END, drive.truth)
    assert made.events == [(BAD, EventKind.LEAP)]
    assert set(made.labels.values()) == {Label.GUARANTEED}


@pytest.mark.parametrize("numbers", [*LEAPS, {"epoch": START - 1, "seq": 7}])
@pytest.mark.parametrize("instead", [0, 1])
def test_after_a_leap_that_came_first_tubes_are_back_after_a_stated_number_of_samples(
    numbers: dict[str, int], instead: int
) -> None:
    """Also after several that were taken for the vehicle."""
    drive, made = history(2), story()
    for k in range(RESYNC + 2 if instead else 1):
        shift = {"epoch": 0, "seq": k, "t": k * SVEA.dt_ns}
        moved = {name: min(value + shift[name], 2**62 if name == "t" else 2**64 - 1) for name, value in numbers.items()}
        made.engine.append(spoiled(samples_of(drive, k, k + 1), **moved))
    made.go_on(drive, off(0.0, slice(None)), 10, 200)
    least = 2 * (1 + 5 + 2 * (LAGS + 1)) + LAGS + 2
    late = 10 + LATE_BATCHES + RESYNC + 1 + least
    assert {made.labels[k] for k in range(late, 200)} == {Label.GUARANTEED}
    assert len(made.kinds(EventKind.LEAP)) <= 2


def test_a_clock_that_leaps_an_hour_and_comes_back_is_told_both_times() -> None:
    drive, made = history(2), story()
    made.engine.append(samples_of(drive, 0, BEGIN))
    for begin, end, ahead in ((BEGIN, BAD, 0), (BAD, BAD + 50, HOUR), (BAD + 50, BAD + 100, 0)):
        for k in range(begin, end):
            one = samples_of(drive, k, k + 1)
            known = PlannedInputs(drive.inputs[None, k + 1 : k + 2], np.zeros((1, 2)))
            tubes = made.engine.step(replace(one, t=one.t + ahead), known)
            made.labels[k] = tubes.labels[0] if tubes.labels else None
            made.events += [(k, event.kind) for event in tubes.events]
    believed = [BAD + RESYNC, BAD + 50 + RESYNC]
    assert made.events == [(BAD, EventKind.LEAP), *((k, EventKind.LEAP) for k in believed)]
    for k in believed:
        assert {made.labels[i] for i in range(k + LAGS, k + 40)} == {Label.GUARANTEED}
