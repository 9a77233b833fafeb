"""What happens for the first time: the parked car that drives off, the first turn, the first reverse, an input that was
constant, a sensor that was stuck. No set is larger than limits allow, what is outside the data is told, and the claims
hold."""

from functools import cache

import numpy as np
import pytest

from fleet_bus.messages import Label
from reach_server.audit import prediction_check as audit
from reach_server.data.observed_range import MARGIN
from reach_server.data.regressors import wrap
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine
from reach_server.engine.results import Tubes
from reach_server.models.kinematic_bounds import limits_ahead
from reach_server.tube.summaries import enclosing
from tests.reach_server.regimes import NEW, NOVEL, REGIMES, TOTAL, WINDOW, Drive, drive, profile, tubes_of

# Each drive is driven with every method.
pytestmark = pytest.mark.slow

METHODS = ("set_membership", "residual_hull", "paper", "lti")
SERVED = (*METHODS, "calibrated")


def linear(method: str) -> bool:
    return method in ("paper", "lti")


@cache
def run(regime: str, method: str, limited: bool = True) -> tuple[Drive, dict[int, Tubes]]:
    driven = drive(regime, linear=linear(method))
    return driven, tubes_of(profile(linear=linear(method), limited=limited), driven, method)


def outside(tubes: Tubes) -> set[str]:
    """The states and inputs that a note calls outside the data."""
    notes = [note for note in tubes.notes[0] if note.startswith("outside the data: ")]
    return set(notes[0].removeprefix("outside the data: ").split(", ")) if notes else set()


@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("method", METHODS)
def test_guaranteed_sets_hold_every_true_state(regime: str, method: str) -> None:
    driven, found = run(regime, method)
    angles = () if linear(method) else (2,)
    assert len(found) > 100
    for k, tubes in found.items():
        assert tubes.labels == (Label.GUARANTEED,)
        for h in range(min(3, TOTAL - 1 - k)):
            held, _ = audit.inside(
                tubes.steps[h], np.zeros((driven.true.shape[1], 0)), driven.true[[k + h + 1]], angles
            )
            assert held.all(), (k, h)


@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("method", SERVED)
def test_no_set_is_larger_than_stated_limits_allow(regime: str, method: str) -> None:
    made = profile(linear=linear(method), limited=True)
    driven, found = run(regime, method)
    # Calibrated sets speak about measured states, which are off once more.
    extra = np.zeros(driven.true.shape[1])
    if method == "calibrated":
        assert made.noise.measurement is not None
        extra = 2.5 * np.abs(made.noise.measurement.matrix()).sum(axis=1)
    for k, tubes in found.items():
        ahead = limits_ahead(made, driven.measured[[k]], 3)
        width = (ahead.high - ahead.low)[0] + 2 * extra
        assert (tubes.area[0] <= width[:, 0] * width[:, 1] * (1 + 1e-5)).all()
        assert (tubes.area_free[0] <= width[:, 0] * width[:, 1] * (1 + 1e-5)).all()
        around = np.sqrt(2.0) if method == "calibrated" else 1.0
        assert (np.ptp(tubes.hull[0], axis=1) <= around * width * (1 + 1e-5)).all()


@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("method", SERVED)
def test_what_is_outside_the_data_is_told_until_enough_has_been_seen(regime: str, method: str) -> None:
    _, found = run(regime, method)
    if NOVEL + 3 not in found:
        # The data of a vehicle that did nothing do not determine a linear model: no tube, no claim.
        assert method == "lti"
        assert regime in ("parked", "turn", "constant input", "frozen sensor")
        return
    told = set().union(*(outside(found[k]) for k in range(NOVEL, NOVEL + 4)))
    assert told >= NEW[regime] - ({"v"} if linear(method) and regime != "frozen sensor" else set())
    assert all(not outside(found[k]) for k in range(TOTAL - 100, TOTAL))


@pytest.mark.parametrize("limited", [True, False])
@pytest.mark.parametrize("regime", REGIMES)
def test_calibrated_sets_claim_nothing_outside_the_data_and_keep_their_rate_within(regime: str, limited: bool) -> None:
    driven, found = run(regime, "calibrated", limited)
    held: dict[Label, list[bool]] = {label: [] for label in Label}
    late = []
    for k, tubes in found.items():
        assert (tubes.labels[0] is Label.UNCOVERED) == bool(outside(tubes)) or tubes.labels[0] is Label.CONTRADICTED
        if k + 1 < TOTAL:
            inside = bool(audit.inside(tubes.steps[0], np.zeros((4, 0)), driven.measured[[k + 1]], (2,))[0][0])
            held[tubes.labels[0]].append(inside)
            late += [inside] if k >= NOVEL + WINDOW else []
    assert found[NOVEL].labels == (Label.UNCOVERED,) or found[NOVEL + 1].labels == (Label.UNCOVERED,)
    assert len(held[Label.CALIBRATED]) > 500
    assert np.mean(held[Label.CALIBRATED]) >= 0.95
    assert np.mean(late) >= 0.95


@pytest.mark.parametrize("regime", REGIMES)
def test_without_stated_limits_sets_stay_within_a_margin_of_what_was_seen(regime: str) -> None:
    driven, found = run(regime, "calibrated", limited=False)
    change = np.abs(np.diff(driven.measured, axis=0))
    change[:, 2] = np.abs(wrap(change[:, 2]))
    way = np.hypot(change[:, 0], change[:, 1])
    for k, tubes in found.items():
        fastest = way[:k].max()
        for h in range(3):
            assert tubes.area[0, h] <= (2 * MARGIN * (h + 1) * fastest) ** 2 * (1 + 1e-5)
        reach = MARGIN * 3 * change[:k].max(axis=0)
        assert (np.ptp(tubes.hull[0, 2], axis=0)[2:] <= 2 * reach[2:] * (1 + 1e-5) + 1e-9).all()


@pytest.mark.parametrize("method", ["set_membership", "paper", "calibrated"])
def test_a_vehicle_whose_sets_are_held_changes_no_other_to_the_last_bit(method: str) -> None:
    """A vehicle gets beside one whose sets are cut what it gets alone."""
    made = profile(linear=linear(method), limited=True)
    driven = [drive(regime, linear=linear(method), seed=seed) for seed, regime in enumerate(("reverse", "parked"))]

    def run_of(cars: list[int]) -> list[Tubes]:
        engine, found = Engine(made, method=method), []
        for slot in range(len(cars)):
            engine.add(f"car-{slot}")
        for k in range(NOVEL + 120):
            one, t = np.ones(len(cars), dtype=np.uint64), np.full(len(cars), 10**18 + k * made.sample_time_ns)
            x, u = (np.stack([getattr(driven[car], name)[k] for car in cars]) for name in ("measured", "u"))
            batch = SampleBatch(
                np.arange(len(cars)), one, one * np.uint64(k), t, np.zeros(len(cars), dtype=np.uint32), x, u
            )
            found.append(engine.step(batch))
        return found

    held = 0
    for alone, both in zip(run_of([0]), run_of([0, 1]), strict=True):
        if alone.vehicles != ("car-0",) or len(both.vehicles) < 2:
            continue
        held += any(note.startswith("within") for note in both.notes[1])
        assert alone.notes[0] == both.notes[0]
        assert alone.labels[0] is both.labels[0]
        for name in ("area", "area_free", "outline", "hull"):
            np.testing.assert_array_equal(getattr(alone, name)[0], getattr(both, name)[0])
        for one_set, other in zip(alone.steps, both.steps, strict=True):
            np.testing.assert_array_equal(one_set.center[0], other.center[0])
            np.testing.assert_array_equal(enclosing(one_set)[0], enclosing(other)[0])
    assert held > 5
