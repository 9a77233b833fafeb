"""The true dynamics of the simulated SVEA and the bounds that its profile gives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from vehicle_agent.svea import (
    INPUT_NAMES,
    SPEED_COVERED,
    STATE_NAMES,
    SveaParameters,
    increment,
    jacobian_bounds,
    limit_command,
    profile,
    step,
)

P = SveaParameters()


def regressors(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Random regressors (count, 7) over the covered range, some at its corners."""
    half = np.array([SPEED_COVERED, *[P.steering_limit, P.velocity_limit] * 3])
    xi = rng.uniform(-1, 1, (count, 7))
    corners = rng.random((count, 7)) < 0.3
    return half * np.where(corners, np.sign(xi), xi)


def dynamics(xi: NDArray[np.float64]) -> NDArray[np.float64]:
    """Increments (..., 4) of regressors (..., 7): v, then (steering, velocity) at lags 0, 1, 2."""
    return increment(P, xi[..., 0], xi[..., 5], xi[..., 2])


def test_increment_agrees_with_fine_integration_of_the_arc() -> None:
    rng = np.random.default_rng(1)
    v, steering, velocity = rng.uniform(-1.7, 1.7, 50), rng.uniform(-0.7, 0.7, 50), rng.uniform(-1.7, 1.7, 50)
    d = increment(P, v, steering, velocity)
    v_after = v + (1 - np.exp(-P.dt / P.speed_time_constant)) * (velocity - v)
    s = P.dt * (v + v_after) / 2
    pieces = 20_000
    heading = (np.arange(pieces)[:, None] + 0.5) / pieces * s * np.tan(steering) / P.wheel_base
    np.testing.assert_allclose(d[:, 0], s * np.cos(heading).mean(axis=0), atol=1e-10)
    np.testing.assert_allclose(d[:, 1], s * np.sin(heading).mean(axis=0), atol=1e-10)
    np.testing.assert_allclose(d[:, 2], s * np.tan(steering) / P.wheel_base, atol=1e-15)
    np.testing.assert_allclose(d[:, 3], v_after - v, atol=1e-15)


def test_increment_of_a_straight_drive() -> None:
    np.testing.assert_allclose(increment(P, 1.0, 0.0, 1.0), [P.dt, 0.0, 0.0, 0.0], atol=1e-17)


def test_step_turns_increment_and_noise_by_the_heading() -> None:
    state = np.array([[1.0, 2.0, np.pi / 2, 1.0], [1.0, 2.0, np.pi, 1.0]])
    noise = np.array([0.001, 0.0005, 0.002, 0.01])
    after = step(P, state, 0.0, 1.0, noise)
    d = P.dt + 0.001
    np.testing.assert_allclose(after[0], [1 - 0.0005, 2 + d, np.pi / 2 + 0.002, 1.01], atol=1e-12)
    np.testing.assert_allclose(after[1], [1 - d, 2 - 0.0005, np.pi + 0.002, 1.01], atol=1e-12)


def test_jacobian_bounds_hold_every_sampled_derivative_and_are_not_loose() -> None:
    lower, upper = jacobian_bounds(P)
    rng = np.random.default_rng(2)
    # Central differences need room inside the covered range.
    h = 1e-5
    xi = regressors(rng, 100_000) * (1 - h)
    low, high = np.full((4, 7), np.inf), np.full((4, 7), -np.inf)
    for column in range(7):
        shift = h * np.eye(7)[column]
        derivative = (dynamics(xi + shift) - dynamics(xi - shift)) / (2 * h)
        low[:, column], high[:, column] = derivative.min(axis=0), derivative.max(axis=0)
    # The error of a central difference: h² times a third derivative of about 1, and rounding.
    assert (low >= lower - 1e-9).all()
    assert (high <= upper + 1e-9).all()
    width, found = upper - lower, high - low
    assert (width <= 1.05 * found + 1e-8).all()
    np.testing.assert_allclose(width[:, [1, 3, 4, 6]], 2e-9)


@given(st.integers(0, 2**32 - 1))
def test_the_mean_value_bound_holds_between_any_two_points(seed: int) -> None:
    lower, upper = jacobian_bounds(P)
    a, b = regressors(np.random.default_rng(seed), 2)
    change, d = dynamics(b) - dynamics(a), b - a
    assert (change <= np.maximum(lower * d, upper * d).sum(axis=1) + 1e-15).all()
    assert (change >= np.minimum(lower * d, upper * d).sum(axis=1) - 1e-15).all()


def test_bounds_follow_the_steering_delay_and_refuse_what_they_were_not_derived_for() -> None:
    prompt = SveaParameters(steering_delay=0)
    lower, upper = jacobian_bounds(prompt)
    np.testing.assert_array_equal(upper[:, [0, 1, 2]], jacobian_bounds(P)[1][:, [0, 5, 2]])
    assert lower.shape == (4, 3)
    with pytest.raises(ValueError, match="in one sample"):
        jacobian_bounds(SveaParameters(dt=1.0))


def test_profile_gives_every_bound() -> None:
    svea = profile()
    assert svea.vehicle_class == "svea"
    assert svea.guaranteed
    assert svea.state_names == STATE_NAMES
    assert svea.input_names == INPUT_NAMES
    assert svea.regressors == (
        "v", "steering", "velocity", "steering[k-1]", "velocity[k-1]", "steering[k-2]", "velocity[k-2]",
    )  # fmt: skip
    assert (svea.frame, svea.input_lags, svea.window, svea.horizon) == ("body", 2, 1000, 10)
    assert svea.sample_time_ns == P.dt_ns == 50_000_000
    assert svea.noise.measurement is not None
    assert svea.noise.measurement.box == pytest.approx([1.5 * bound for bound in P.sensor_noise])
    assert svea.maps_to == {"x1": "x", "x2": "y"}


def test_speed_stays_where_the_bounds_hold() -> None:
    v = P.velocity_limit
    for _ in range(1000):
        v += float(increment(P, v, 0.0, P.velocity_limit)[3]) + P.process_noise[3]
    assert v < 1.76 < SPEED_COVERED


@given(st.tuples(st.floats(-5, 5), st.floats(-9, 9)), st.tuples(st.floats(-0.7, 0.7), st.floats(-1.7, 1.7)))
def test_limited_commands_obey_limits_and_rates(wanted: tuple[float, float], previous: tuple[float, float]) -> None:
    before = np.array(previous)
    command = limit_command(P, np.array(wanted), before)
    assert (np.abs(command) <= [P.steering_limit, P.velocity_limit]).all()
    assert (np.abs(command - before) <= np.array([P.steering_rate, P.velocity_rate]) * P.dt).all()


def test_a_command_within_reach_is_taken_as_it_is() -> None:
    np.testing.assert_array_equal(limit_command(P, np.array([0.1, 0.15]), np.zeros(2)), [0.1, 0.15])
