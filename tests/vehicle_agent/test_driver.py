"""The driver: in time, on the path, and within what the actuators can do."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.examples import examples
from vehicle_agent.driver import Driver
from vehicle_agent.path import Path, draw_path
from vehicle_agent.route import Route
from vehicle_agent.simulate import Car
from vehicle_agent.svea import SveaParameters

P = SveaParameters()


def bend(at: float, duration: float = 10.0) -> Path:
    fields: dict[str, Any] = {
        "route": "bend",
        "duration": duration,
        "start": {"x": [0, 0], "y": [0, 0], "yaw": [0.3, 0.3]},
        "way_points": [
            {"x": 1.5, "y": 0, "speed": 0.8},
            {"x": 3, "y": 1, "speed": 0.8, "at": at},
            {"x": 4, "y": 1, "speed": 0.8},
        ],
    }
    return draw_path(Route.model_validate(fields), np.random.default_rng(0))


@pytest.mark.parametrize("at", [3.0, 4.0, 6.0, 8.0])
def test_the_driver_is_on_the_path_and_in_time(at: float) -> None:
    path = bend(at)
    driver, car = Driver(P, path), Car(P, np.append(path.start, 0.0), np.random.default_rng(1))
    for k in range(round(at / P.dt)):
        off = np.hypot(*(path.points - car.state[:2]).T).min()
        assert off < 0.08
        car.advance(driver.command(k * P.dt, car.measure()))
    assert np.hypot(*(car.state[:2] - path.points[path.deadlines[0][0]])) < 0.12


def test_the_driver_stops_at_the_end_of_the_path() -> None:
    path = bend(4.0)
    driver, car = Driver(P, path), Car(P, np.append(path.start, 0.0), np.random.default_rng(1))
    command = np.zeros(2)
    for k in range(200):
        command = driver.command(k * P.dt, car.measure())
        car.advance(command)
    assert command[1] == 0.0
    assert abs(car.state[3]) < 0.1


@settings(max_examples=examples(30))
@given(st.integers(0, 2**32 - 1))
def test_commands_obey_limits_and_rates_whatever_is_measured(seed: int) -> None:
    rng = np.random.default_rng(seed)
    driver, before = Driver(P, bend(4.0)), np.zeros(2)
    for k in range(60):
        command = driver.command(k * P.dt, rng.uniform(-5, 5, 4))
        assert (np.abs(command) <= [P.steering_limit, P.velocity_limit]).all()
        assert (np.abs(command - before) <= np.array([P.steering_rate, P.velocity_rate]) * P.dt).all()
        before = command
