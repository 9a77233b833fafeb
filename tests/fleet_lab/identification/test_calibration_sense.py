"""Recordings that contradict themselves: what is wrong is named with what to do, and what is right raises no doubt."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fleet_lab.identification.draft import complete
from fleet_lab.identification.motion import agreement
from fleet_lab.identification.names import roles_of
from fleet_lab.identification.sense import Findings, examine
from tests.fleet_lab.wavy import wavy
from vehicle_agent.recording import Recording, load_recording

DATA = Path(__file__).parents[2] / "data" / "recordings"


def found_in(recording: Recording, given: dict[str, Any] | None = None) -> Findings:
    fields, _ = complete(given or {}, [recording], "car")
    return examine([recording], fields, guessed="roles" not in (given or {}))


def with_column(recording: Recording, index: int, values: Any) -> Recording:
    x = recording.x.copy()
    x[:, index] = values
    return replace(recording, x=x)


@pytest.mark.parametrize("dt", [0.002, 0.01, 0.05, 0.2])
@pytest.mark.parametrize("runs", [1, 3])
def test_a_sound_recording_raises_no_doubt(dt: float, runs: int) -> None:
    assert found_in(wavy(1200, dt=dt, runs=runs)) == Findings()


@pytest.mark.parametrize("name", ["fix_dart_free", "fix_f1tenth_koopman", "fix_upenn_pf"])
def test_real_recordings_raise_no_doubt(name: str) -> None:
    assert found_in(load_recording(DATA / f"{name}.npz")) == Findings()


def test_a_vehicle_that_goes_backwards_raises_no_doubt() -> None:
    one = wavy(800)
    assert found_in(with_column(one, 2, one.x[:, 2] + np.pi)) == Findings()


def test_a_vehicle_that_stands_raises_no_doubt() -> None:
    rng = np.random.default_rng(2)
    one = wavy(800)
    still = replace(one, x=rng.normal(size=one.x.shape) * [0.002, 0.002, 0.001, 0.0005])
    assert found_in(still) == Findings()


@pytest.mark.parametrize(("unit", "per_second"), [("ms", 1e3), ("µs", 1e6), ("ns", 1e9)])
@pytest.mark.parametrize("origin", [0.0, 1.7e9])
@pytest.mark.parametrize("speed", ["v", "s", None])
@pytest.mark.parametrize("dt", [0.01, 0.05])
def test_stamps_in_another_unit(unit: str, per_second: float, origin: float, speed: str | None, dt: float) -> None:
    one = wavy(600, dt=dt)
    kept = [0, 1, 2] if speed is None else [0, 1, 2, 3]
    late = replace(
        one, t=per_second * (origin + one.t), x=one.x[:, kept], state_units=tuple(one.state_units[i] for i in kept),
        state_names=("x", "y", "yaw") if speed is None else ("x", "y", "yaw", speed),
    )  # fmt: skip
    found = found_in(late)
    if speed != "v" and per_second * dt <= 60:
        # Nothing contradicts the stamps: a vehicle may be sampled every 10 s.
        assert not found.problems
        assert any("if the stamps t are in ms, divide them by 1000" in text for text in found.doubts)
        return
    assert found.sample_time == pytest.approx(dt, rel=1e-2)
    (problem,) = found.problems
    assert f"the stamps t look like {unit}, not s" in problem
    assert f"divide t by {per_second:.0e}".replace("e+0", "e") in problem


def test_a_given_sample_time_tells_the_unit_of_the_stamps() -> None:
    one = wavy(600)
    late = replace(one, t=1e3 * one.t, x=one.x[:, :2], state_names=("x", "y"), state_units=("m", "m"))
    found = found_in(late, {"sample_time": "50 ms"})
    assert "look like ms" in found.problems[0]
    assert "the sample_time given is 50 ms" in found.problems[0]


def test_long_intervals_that_agree_with_the_speed_are_no_mistake() -> None:
    one = wavy(600)
    slow = with_column(replace(one, t=200 * one.t), 3, one.x[:, 3] / 200)
    assert found_in(slow) == Findings()
    assert "are the stamps t in seconds?" in found_in(replace(slow, t=10 * slow.t)).problems[0]


@pytest.mark.parametrize("unit", ["deg", "degrees", "°"])
def test_a_heading_in_degrees(unit: str) -> None:
    one = wavy(600)
    (problem,) = found_in(
        replace(with_column(one, 2, np.rad2deg(one.x[:, 2])), state_units=("m", "m", unit, "m/s"))
    ).problems
    assert "the heading yaw is in degrees" in problem
    assert "x[:, 2] = np.deg2rad(…)" in problem


@pytest.mark.parametrize("whole", [0.0, 360.0])
def test_a_heading_in_degrees_that_is_said_to_be_in_radians(whole: float) -> None:
    one = wavy(1200)
    degrees = np.rad2deg(one.x[:, 2])
    degrees = np.mod(degrees, whole) if whole else degrees
    assert (
        "the heading yaw is in degrees, held against the motion" in found_in(with_column(one, 2, degrees)).problems[0]
    )


def test_a_heading_of_a_compass() -> None:
    one = wavy(1200)
    (problem,) = found_in(with_column(one, 2, np.pi / 2 - one.x[:, 2])).problems
    assert "the heading yaw is clockwise" in problem
    assert "π/2 - bearing" in problem
    (problem,) = found_in(with_column(one, 2, np.mod(90 - np.rad2deg(one.x[:, 2]), 360))).problems
    assert "clockwise and in degrees" in problem


def test_a_heading_that_is_none_is_doubted() -> None:
    rng = np.random.default_rng(1)
    one = wavy(1200)
    assert "unlike the direction of motion" in found_in(with_column(one, 2, rng.uniform(-3, 3, 1200))).doubts[0]
    assert "+40° off" in found_in(with_column(one, 2, one.x[:, 2] + np.deg2rad(40))).doubts[0]


@pytest.mark.parametrize(
    ("factor", "unit", "problem", "doubt"),
    [
        (1.0, "m/s", "", ""),
        (3.6, "km/h", "", ""),
        (1e3, "mm/s", "", ""),
        (3.6, "m/s", "", "(3.6: km/h)"),
        (1e3, "m/s", "move 0.001 times as far as v times the interval says", ""),
        (1e-3, "m/s", "times as far as v times the interval says", ""),
        (0.1, "m/s", "", "times as far as v times the interval says"),
    ],
)
def test_a_speed_that_the_position_does_not_move_by(factor: float, unit: str, problem: str, doubt: str) -> None:
    one = wavy(1200)
    fast = with_column(one, 3, factor * one.x[:, 3])
    found = found_in(replace(fast, state_units=("m", "m", "rad", unit)))
    for said, texts in ((problem, found.problems), (doubt, found.doubts)):
        assert len(texts) == bool(said)
        assert all(said in text and "under roles: {speed: …}" in text for text in texts)


def test_all_that_is_wrong_is_told_at_once() -> None:
    one = wavy(600)
    found = found_in(replace(with_column(one, 2, np.rad2deg(one.x[:, 2])), t=1e3 * one.t))
    assert [any(word in text for text in found.problems) for word in ("stamps", "degrees")] == [True, True]


@pytest.mark.parametrize(
    "speed",
    ["v", "V", "vel", "Vel", "velocity", "speed", "v_x", "vx", "vel_x", "linear_velocity", "v_long", "odom_vel"],
)
@pytest.mark.parametrize("heading", ["yaw", "theta", "Theta", "heading", "psi", "yaw_angle", "th"])
def test_common_names_are_recognised(speed: str, heading: str) -> None:
    one = replace(wavy(600), state_names=("pos_x", "pos_y", heading, speed))
    fields, choices = complete({}, [one], "car")
    assert fields["roles"] == {
        "position": ["pos_x", "pos_y"],
        "heading": heading,
        "speed": speed,
        "steering": "steering",
    }
    (why,) = (choice.why for choice in choices if choice.field == "roles")
    for said in ("pos_x and pos_y as position", f"{speed} as speed", f"{heading} as heading", "steering as steering"):
        assert said in why


def test_rates_are_no_headings_and_lateral_speeds_no_speeds() -> None:
    angle = {"unit": "rad", "angle": True}
    state = {"x": "m", "y": "m", "theta": angle, "theta_dot": "rad/s", "v_y": "m/s", "vel": "m/s"}
    assert roles_of(state, {"delta": "rad"}) == {
        "position": ["x", "y"], "heading": "theta", "speed": "vel", "lateral_speed": "v_y", "yaw_rate": "theta_dot",
        "steering": "delta",
    }  # fmt: skip


def test_a_speed_without_a_known_name_is_recognised_by_the_motion() -> None:
    one = wavy(600)
    noise = 5 * np.random.default_rng(0).normal(size=(600, 1))
    named = replace(
        one, x=np.column_stack([one.x, noise]), state_names=("x", "y", "yaw", "q4", "q5"),
        state_units=("m", "m", "rad", "m/s", "m/s"),
    )  # fmt: skip
    fields, choices = complete({}, [named], "car")
    assert fields["roles"]["speed"] == "q4"
    assert any("q4 as speed, because the position moves by it" in choice.why for choice in choices)


def test_what_is_not_recognised_is_told() -> None:
    one = wavy(600)
    other = replace(one, state_names=("x", "y", "q3", "q4"), state_units=("m", "m", "rad", "1"))
    doubts = found_in(other).doubts
    assert [text.partition(" (left: q3, q4)")[0] for text in doubts] == [
        "no column is recognised as the heading", "no column is recognised as the speed",
    ]  # fmt: skip
    assert "roles: {speed: NAME}" in doubts[1]
    # Whoever states roles knows what is left out.
    assert found_in(other, {"roles": {"position": ["x", "y"]}}) == Findings()


def test_inputs_that_are_not_there() -> None:
    one = wavy(600)
    none = replace(one, u=np.zeros((600, 0)), input_names=(), input_units=())
    assert ["no input is recorded: what the driver does counts as error" in text for text in found_in(none).doubts] == [
        True
    ]
    unknown = replace(one, u=np.where([True, False], np.nan, one.u))
    fields, choices = complete({}, [unknown], "car")
    assert list(fields["inputs"]) == ["velocity"]
    assert "steering" not in fields["roles"]
    assert any("NaN throughout, left out: steering" in choice.why for choice in choices)
    assert found_in(unknown) == Findings()
    assert (
        "no input is recorded (steering, velocity NaN throughout)"
        in found_in(replace(one, u=np.full((600, 2), np.nan))).doubts[0]
    )
    (problem,) = found_in(unknown, {"inputs": {"steering": None, "velocity": None}}).problems
    assert problem == "the input steering is NaN in all rows: leave it out of inputs, or record it"
    gaps = replace(one, u=np.where(np.arange(600)[:, None] % 10 == 0, np.nan, one.u))
    assert ["is NaN in 10.0 % of the rows" in text for text in found_in(gaps).doubts] == [True, True]


@pytest.mark.parametrize(
    "roles",
    [
        {},
        {"position": ["x"]},
        {"position": ["x", "z"]},
        {"speed": 3},
        7,
        {"heading": "w"},
        {"speed": ["v"]},
        {"position": "xy"},
    ],
)
def test_roles_that_cannot_be_are_left_to_the_profile(roles: Any) -> None:
    assert found_in(wavy(600), {"roles": roles, "frame": "world"}) == Findings()


@pytest.mark.parametrize(
    "state", [{"x": "m", "y": "m", "z": "m/s"}, {"px": "m", "py": "m", "v": "m/s"}, {"x": 3, "y": None}]
)
def test_states_that_were_not_recorded_are_left_to_the_profile(state: dict[str, Any]) -> None:
    assert not found_in(wavy(600), {"state": state}).problems


@pytest.mark.parametrize("huge", [1e30, 1e200, 1e300])
@pytest.mark.parametrize("column", [0, 2, 3])
def test_huge_values_are_survived(huge: float, column: int) -> None:
    one = wavy(600)
    found_in(with_column(one, column, np.where(np.arange(600) == 300, huge, one.x[:, column])))
    found_in(with_column(one, column, np.where(np.arange(600) % 2, huge, -huge)))


def test_how_far_a_speed_goes_is_counted_over_known_ways() -> None:
    t = np.linspace(0, 10, 400)
    x = np.column_stack([3 * t, 4 * t, np.full(400, 5.0)])
    line = Recording(t, x, np.zeros((400, 0)), np.zeros(400, np.int64), ("a", "b", "s"), ("m", "m", "m/s"), (), ())
    assert agreement([line], ("a", "b"), "s") == pytest.approx(1.0, rel=1e-9)
    in_km = replace(line, x=x / [1000, 1, 1], state_units=("km", "m", "m/s"))
    assert agreement([in_km], ("a", "b"), "s") == pytest.approx(1.0, rel=1e-9)
    assert agreement([replace(line, x=np.zeros_like(x))], ("a", "b"), "s") is None
