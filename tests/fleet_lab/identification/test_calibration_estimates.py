"""Estimates from recordings whose timing, delay and noise are known."""

from dataclasses import replace

import numpy as np
import pytest

from fleet_bus.errors import ProfileError, RecordingError
from fleet_bus.messages import VehicleProfile, parse_profile
from fleet_lab.identification.draft import complete, observed_limits, round_up
from fleet_lab.identification.estimates import input_lags, measurement_noise, timing
from tests.fleet_lab.evaluation.test_evaluation_runs import PROFILE
from tests.fleet_lab.wavy import NOISE, wavy
from vehicle_agent.recording import Recording


def stamped(intervals: list[float]) -> Recording:
    t = np.concatenate([[0.0], np.cumsum(intervals)])
    count = len(t)
    return replace(wavy(count), t=t)


def test_sample_time_is_the_round_number_near_the_median() -> None:
    rng = np.random.default_rng(0)
    found = timing([stamped((0.01003 + 2e-4 * rng.normal(size=400)).tolist())], None, None)
    assert (found.sample_time, found.tolerance) == (0.01, 0.25)
    assert found.share > 0.99


def test_the_tolerance_holds_most_intervals() -> None:
    found = timing([stamped([0.02] * 380 + [0.0279] * 20)], None, None)
    assert (found.sample_time, found.tolerance, found.share) == (0.02, 0.4, 1.0)
    wide = timing([stamped([0.02] * 300 + [0.5] * 20)], None, None)
    assert (wide.tolerance, wide.share) == (0.75, 300 / 320)
    given = timing([stamped([0.02] * 300)], 0.04, 0.1)
    assert (given.sample_time, given.tolerance, given.share) == (0.04, 0.1, 0.0)


def test_single_samples_say_nothing() -> None:
    with pytest.raises(RecordingError, match="three samples"):
        timing([wavy(3, runs=3)], None, None)


def test_measurement_noise() -> None:
    found = measurement_noise([wavy(3000)], PROFILE)
    deviation = np.array(NOISE) / np.sqrt(3)
    # What motion adds at 20 Hz makes it larger.
    assert (np.array(found.deviation) > 0.9 * deviation).all()
    assert (np.array(found.deviation) < 4 * deviation).all()
    assert found.deviation[0] == found.deviation[1]
    assert found.bound == tuple(4 * d for d in found.deviation)


def test_noise_is_taken_from_where_the_vehicle_stands() -> None:
    rng = np.random.default_rng(1)
    rest = wavy(400)
    x = np.concatenate([wavy(600).x, np.zeros((400, 4))])
    x[:, :2] += 0.02 * rng.normal(size=(1000, 2)) * (np.arange(1000) < 600)[:, None]
    x[600:, :2] += 1e-3 * rng.normal(size=(400, 2))
    both = Recording(
        0.05 * np.arange(1000, dtype=np.float64), x, np.zeros((1000, 2)), np.zeros(1000, dtype=np.int64),
        rest.state_names, rest.state_units, rest.input_names, rest.input_units,
    )  # fmt: skip
    found = measurement_noise([both], PROFILE)
    assert found.deviation[0] == pytest.approx(1e-3, rel=0.3)
    assert "standing" in found.how[0]


def test_noise_of_a_value_that_is_held() -> None:
    one = wavy(600)
    x = one.x.copy()
    x[:, 3] = np.repeat(x[::10, 3], 10)
    found = measurement_noise([replace(one, x=x)], PROFILE)
    assert found.deviation[3] > 0
    assert "mean square" in found.how[3]


@pytest.mark.parametrize("delay", [0, 3])
def test_the_delay_is_found(delay: int) -> None:
    found = input_lags([wavy(1500, delay=delay)], PROFILE)
    assert delay <= found.chosen <= delay + 1
    error = dict(zip(found.tried, found.error["yaw"], strict=True))
    assert delay == 0 or error[delay] < 0.9 * error[0]


def test_lags_of_vehicles_without_inputs() -> None:
    profile = parse_profile({"class": "a", "state": {"x": "m", "y": "m"}, "sample_time": 0.05})
    assert input_lags([wavy(300).select(profile)], profile).chosen == 0


def test_columns_and_roles_are_guessed_from_their_names() -> None:
    fields, choices = complete({}, [wavy(300)], "my car #3")
    profile = VehicleProfile.model_validate({**fields, "sample_time": 0.05})
    assert profile.vehicle_class == "my-car-3"
    assert profile.state_names == ("x", "y", "yaw", "v")
    assert profile.angles.tolist() == [False, False, True, False]
    assert profile.frame == "body"
    assert profile.roles.model_dump(exclude_none=True) == {
        "position": ("x", "y"), "heading": "yaw", "speed": "v", "steering": "steering",
    }  # fmt: skip
    assert {choice.field for choice in choices} == {"class", "state", "inputs", "roles", "frame", "future_inputs"}


def test_what_is_given_stays() -> None:
    given = {"class": "mine", "state": {"y": None, "x": {"limits": [-9, 9]}}, "inputs": {}, "roles": {}}
    fields, choices = complete(given, [wavy(300)], "other")
    profile = VehicleProfile.model_validate({**fields, "sample_time": 0.05})
    assert (profile.vehicle_class, profile.state_names, profile.frame) == ("mine", ("y", "x"), "world")
    assert profile.state["x"].unit == "m"
    assert {choice.field for choice in choices} == {"frame", "future_inputs"}


def test_names_of_other_fields() -> None:
    one = replace(wavy(300), state_names=("east", "north", "course", "w"), input_names=("delta", "gas"))
    fields, _ = complete({}, [one], "boat")
    assert fields["roles"] == {
        "position": ["east", "north"], "heading": "course", "steering": "delta", "speed": "w",
    }  # fmt: skip
    plain = replace(wavy(300), state_names=("a", "b", "c", "d"))
    fields, _ = complete({}, [plain], "thing")
    assert (fields["roles"], fields["frame"]) == ({"steering": "steering"}, "world")


def test_recordings_of_different_columns() -> None:
    other = replace(wavy(300), state_names=("x", "y", "yaw", "speed"), name="second")
    with pytest.raises(ProfileError, match="second"):
        complete({}, [wavy(300), other], "car")


def test_observed_limits_are_rounded_outwards() -> None:
    one = wavy(300)
    found = observed_limits([one], {"steering": "rad", "velocity": {"unit": "m/s", "limits": [0, 2]}})
    assert set(found) == {"steering"}
    low, high = found["steering"]
    assert low <= one.u[:, 0].min() < one.u[:, 0].max() <= high
    assert high < one.u[:, 0].max() + 0.02


@pytest.mark.parametrize(("value", "rounded"), [(0.0123, 0.013), (0.012, 0.012), (-0.0129, -0.012), (0, 0), (1e-15, 0)])
def test_rounding_upwards(value: float, rounded: float) -> None:
    assert round_up(value) == pytest.approx(rounded, rel=1e-12)
