"""Filters: the bound holds on anything, and the estimate is better than the sensor on a drive."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from fleet_bus.errors import UsageError
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
