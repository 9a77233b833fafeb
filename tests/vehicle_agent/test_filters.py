"""Filters: the bound holds on anything, and the estimate is better than the sensor on a drive."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from fleet_bus.errors import MessageError, UsageError
from fleet_bus.messages import parse_profile
from tests.examples import examples
from vehicle_agent.angles import wrap
from vehicle_agent.filters import Filter, KinematicFilter, PassThrough, filter_for
from vehicle_agent.route import load_route
from vehicle_agent.simulate import simulate_drive
from vehicle_agent.svea import SveaParameters, profile

P = SveaParameters()


def filtered(tested: Filter, measured: NDArray[np.float64], dt: int = P.dt_ns) -> NDArray[np.float64]:
    return np.array([tested.update(k * dt, z) for k, z in enumerate(measured)])


def errors(states: NDArray[np.float64], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    difference = states - truth
    difference[:, 2] = wrap(difference[:, 2])
    return difference


@settings(max_examples=examples(30))
@given(
    seed=st.integers(0, 2**32 - 1),
    kappa=st.floats(0.01, 2),
    speed=st.sampled_from([0.0, 0.1, 10.0]),
    intervals=st.lists(st.integers(1, 10**9), min_size=20, max_size=20),
)
def test_the_published_error_never_exceeds_its_bound(
    seed: int, kappa: float, speed: float, intervals: list[int]
) -> None:
    """Truth as wild as can be (steps of any size, angles through the wrap), errors at the sensor's bound."""
    rng = np.random.default_rng(seed)
    bound = np.array([0.003, 0.2, 0.004])
    truth = rng.normal(0, 5, 3) + np.cumsum(rng.normal(0, speed, (20, 3)), axis=0)
    truth[:, 2] = wrap(truth[:, 2])
    measured = truth + bound * rng.choice([-1, 1, 0.3], (20, 3)) * (1 - 1e-9)
    measured[:, 2] = wrap(measured[:, 2])
    tested = KinematicFilter(bound, 0.05, angles=[False, False, True], correction=kappa)
    published = np.array([tested.update(t, z) for t, z in zip(np.cumsum(intervals).tolist(), measured, strict=True)])
    assert (np.abs(errors(published, truth)) <= (1 + kappa) * bound).all()
    assert (published[:, 2] > -np.pi).all()
    assert (published[:, 2] <= np.pi).all()


def test_on_a_drive_published_states_are_within_the_profile_and_better_than_measured() -> None:
    drive = simulate_drive(load_route("parking-lot"), 1)
    published = filtered(filter_for(profile()), drive.measured)
    noise = profile().noise.measurement
    assert noise is not None
    error = errors(published, drive.truth)
    assert (np.abs(error) <= np.array(noise.box)).all()
    rms, raw = (np.sqrt((e**2).mean(axis=0)) for e in (error, errors(drive.measured.copy(), drive.truth)))
    assert (rms < 0.97 * raw).all()


def test_a_turn_through_pi_is_smooth() -> None:
    yaw = np.linspace(3.0, 3.4, 41)
    measured = wrap(yaw)[:, None]
    published = filtered(KinematicFilter([0.004], 0.05, angles=[True]), measured)
    assert (np.abs(wrap(published[:, 0] - yaw)) <= 0.002).all()


def test_reset_forgets() -> None:
    tested = KinematicFilter([0.1, 0.1], 0.05)
    measured = np.array([[0.0, 0.0], [1.0, -1.0], [5.0, 2.0]])
    first = filtered(tested, measured)
    tested.reset()
    np.testing.assert_array_equal(filtered(tested, measured), first)
    np.testing.assert_array_equal(first[0], measured[0])


def test_a_component_without_noise_is_published_as_measured() -> None:
    measured = np.random.default_rng(3).normal(size=(30, 2))
    published = filtered(KinematicFilter([0.0, 0.5], 0.05), measured)
    np.testing.assert_array_equal(published[:, 0], measured[:, 0])
    assert (published[1:, 1] != measured[1:, 1]).any()


TINY = parse_profile(
    {
        "class": "car", "state": {"x": "m", "yaw": {"unit": "rad", "angle": True}}, "sample_time": 0.05,
        "noise": {"measurement": {"box": [0.1, 0.004]}},
    }
)  # fmt: skip

FILTERS: dict[str, Callable[[], Filter]] = {
    "pass through": PassThrough,
    "plain": lambda: KinematicFilter([0.1, 0.004], 0.05),
    "angle": lambda: KinematicFilter([0.1, 0.004], 0.05, angles=[False, True]),
    "one without noise": lambda: KinematicFilter([0.0, 0.004], 0.05, angles=[False, True]),
    "of a profile": lambda: filter_for(TINY),
}
every_filter = pytest.mark.parametrize("made", FILTERS.values(), ids=FILTERS)


def drive_of(samples: int) -> NDArray[np.float64]:
    k = np.arange(samples)
    return np.column_stack([0.3 * np.sin(0.1 * k), wrap(0.2 * k)])


@every_filter
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("column", [0, 1])
def test_what_is_no_number_is_refused_and_leaves_no_trace(made: Callable[[], Filter], bad: float, column: int) -> None:
    measured = drive_of(60)
    tested, untroubled = made(), made()
    for k, z in enumerate(measured):
        if k % 10 in (0, 5, 6):
            spoiled = z.copy()
            spoiled[column] = bad
            with pytest.raises(MessageError, match="not_finite") as refused:
                tested.update(k * P.dt_ns, spoiled)
            assert refused.value.reason == "not_finite"
        np.testing.assert_array_equal(tested.update(k * P.dt_ns, z), untroubled.update(k * P.dt_ns, z))
    assert tested.restarts == 0


@every_filter
@pytest.mark.parametrize("bad", [1e12, 1e30, 1e300, -1e300, 1.7e308])
@pytest.mark.parametrize("column", [0, 1])
def test_a_huge_value_costs_what_went_before_and_no_more(made: Callable[[], Filter], bad: float, column: int) -> None:
    """Once it is over, the filter is as good as new: one that begins with the next sound sample says the same."""
    measured = drive_of(60)
    measured[20, column] = bad
    tested, fresh, calm = made(), made(), made()
    for k, z in enumerate(measured):
        published = tested.update(k * P.dt_ns, z)
        assert np.isfinite(published).all()
        if k > 20 and tested.restarts:
            np.testing.assert_array_equal(published, fresh.update(k * P.dt_ns, z))
        elif k > 40:
            # On the circle every number is an angle: it is forgotten as any other wrong one.
            np.testing.assert_allclose(published, calm.update(k * P.dt_ns, z), atol=1e-6)
        else:
            calm.update(k * P.dt_ns, drive_of(60)[k])
    on_circle = np.abs(made().update(0, np.array([0.0, 7.0]))[1]) < np.pi
    assert tested.restarts == (0 if isinstance(tested, PassThrough) or (column == 1 and on_circle) else 2)


UGLY = st.sampled_from(
    [0.0, -0.0, 1.0, -3.2, 1e-320, 1e9, -1e15, 1e30, 1e154, -1e300, 1.7e308, -1.7e308, np.nan, np.inf]
)


@settings(max_examples=200, deadline=None)
@given(
    name=st.sampled_from(list(FILTERS)),
    values=st.lists(st.tuples(UGLY, UGLY), min_size=1, max_size=12),
    intervals=st.lists(st.sampled_from([1, 50_000_000, 10**12, 2**62]), min_size=12, max_size=12),
)
@pytest.mark.slow
def test_no_sequence_of_measurements_poisons_a_filter(
    name: str, values: list[tuple[float, float]], intervals: list[int]
) -> None:
    """Whatever came: what is published is finite and within its bound, and after a few sound samples also smooth."""
    tested = FILTERS[name]()
    t, refused = 0, 0
    for value, interval in zip(values, intervals, strict=False):
        t += interval
        z = np.array(value)
        if not np.isfinite(z).all():
            with pytest.raises(MessageError):
                tested.update(t, z)
            refused += 1
            continue
        published = tested.update(t, z)
        assert np.isfinite(published).all()
        assert np.abs(published[0] - z[0]) <= 0.05
    rng = np.random.default_rng(1)
    truth = drive_of(200)
    seen = truth + rng.uniform(-1, 1, truth.shape) * [0.1, 0.004]
    published = np.array([tested.update(t + (k + 1) * P.dt_ns, z) for k, z in enumerate(seen)])
    assert np.isfinite(published).all()
    if name in ("angle", "of a profile"):
        rms = np.sqrt(((published - truth)[100:, 0] ** 2).mean())
        assert rms < 0.97 * np.sqrt(((seen - truth)[100:, 0] ** 2).mean())


def test_a_clock_that_does_not_go_on_begins_anew() -> None:
    tested = KinematicFilter([0.1, 0.004], 0.05)
    for t, z in ((10, [0.0, 0.0]), (20, [0.1, 0.0]), (20, [0.2, 0.0]), (5, [0.3, 0.0])):
        np.testing.assert_allclose(tested.update(t, np.array(z)), z, atol=0.05)
    assert tested.restarts == 2


@pytest.mark.parametrize(("bound", "sample_time"), [(1e200, 0.05), (1e61, 0.05), (0.1, 1e-200)])
def test_numbers_whose_squares_overflow_are_refused(bound: float, sample_time: float) -> None:
    with pytest.raises(UsageError, match="other units"):
        KinematicFilter([bound], sample_time)


def test_a_bound_too_small_for_doubles_counts_as_none() -> None:
    measured = np.random.default_rng(3).normal(size=(30, 1))
    np.testing.assert_array_equal(filtered(KinematicFilter([1e-200], 0.05), measured), measured)


@pytest.mark.parametrize(
    ("bound", "sample_time", "options"),
    [
        ([-1.0], 0.05, {}),
        ([np.nan], 0.05, {}),
        ([1.0], 0.0, {}),
        ([1.0], 0.05, {"correction": -0.5}),
        ([1.0], 0.05, {"tracking_index": np.inf}),
    ],
)
def test_unusable_numbers_are_refused(bound: list[float], sample_time: float, options: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="must be finite and not negative"):
        KinematicFilter(
            bound,
            sample_time,
            correction=options.get("correction", 0.5),
            tracking_index=options.get("tracking_index", 2.0),
        )
    with pytest.raises(UsageError, match="mask of angles"):
        KinematicFilter([1.0], 0.05, angles=[True, False])


def test_without_a_box_measurements_pass_through() -> None:
    fields = {"class": "car", "state": {"x": "m"}, "sample_time": 0.1}
    shear = {"generators": [[0.1, 0.2]]}
    for noise in ({}, {"measurement": shear}):
        tested = filter_for(parse_profile({**fields, "noise": noise}))
        assert isinstance(tested, PassThrough)
        tested.reset()
        np.testing.assert_array_equal(tested.update(0, np.array([0.7])), [0.7])
