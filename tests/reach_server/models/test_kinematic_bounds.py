"""Sets from limits alone against vehicles that use them to the full."""

import numpy as np
import pytest

from fleet_bus.messages import VehicleProfile, parse_profile
from reach_server.models.kinematic_bounds import limit_sets
from reach_server.numeric.types import FloatArray

N = 8
DT = 0.1
CAR: dict[str, object] = {
    "x": "m",
    "y": "m",
    "yaw": {"unit": "rad", "angle": True, "rate": 2.0},
    "v": {"unit": "m/s", "limits": [-1.0, 2.0], "rate": 4.0},
    "s": {"unit": "rad", "limits": [-0.4, 0.4]},
}


def profile(state: dict[str, object] | None = None, **changes: object) -> VehicleProfile:
    fields: dict[str, object] = {
        "class": "car",
        "state": state or CAR,
        "sample_time": DT,
        "noise": {"measurement": {"box": [0.05, 0.05, 0.02, 0.1, 0.01]}},
        "future_inputs": "learned",
        "roles": {"position": ["x", "y"], "heading": "yaw", "speed": "v"},
    }
    return parse_profile(fields | changes)


def boxes(made: VehicleProfile, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper bounds (B, N, n)."""
    found = limit_sets(made, x, N)
    assert found is not None
    center, generators = found
    assert generators.shape == (*center.shape, center.shape[-1])
    half = np.abs(generators).sum(axis=-1)
    np.testing.assert_array_equal(generators, half[..., None] * np.eye(center.shape[-1]))
    return center - half, center + half


def driven(rng: np.random.Generator, count: int, fine: int = 50) -> tuple[FloatArray, FloatArray]:
    """True states (count, N + 1, 5) that obey the limits, and what is received of the first."""
    v = rng.uniform(-1, 2, count)
    angle, steering = rng.uniform(-3, 3, count), rng.uniform(-0.4, 0.4, count)
    p = rng.normal(size=(count, 2))
    # Half of them accelerate and turn as hard as they can, all the time.
    hard = rng.random(count) < 0.5
    gas, turn = rng.choice([-4.0, 4.0], count), rng.choice([-2.0, 2.0], count)
    states = [np.column_stack([p, angle, v, steering])]
    for _ in range(N):
        for _ in range(fine):
            dt = DT / fine
            before = v
            v = np.clip(v + dt * np.where(hard, gas, rng.uniform(-4, 4, count)), -1, 2)
            p = p + dt * ((v + before) / 2)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
            angle = angle + dt * np.where(hard, turn, rng.uniform(-2, 2, count))
            steering = rng.uniform(-0.4, 0.4, count)
        states.append(np.column_stack([p, angle, v, steering]))
    error = rng.choice([-1.0, 1.0], (count, 5)) * [0.05, 0.05, 0.02, 0.1, 0.01]
    return np.stack(states, axis=1), states[0] + error


def test_what_obeys_the_limits_is_inside() -> None:
    true, received = driven(np.random.default_rng(0), 2000)
    low, high = boxes(profile(), received)
    assert (true[:, 1:] >= low - 1e-12).all()
    assert (true[:, 1:] <= high + 1e-12).all()


def test_the_bounds_are_those_that_a_vehicle_can_reach() -> None:
    x = np.array([[1.0, 2.0, 3.0, 0.9, 0.0]])
    low, high = boxes(profile(), x)
    t = DT * np.arange(1, N + 1)
    # 1 m/s at most now, 2 m/s after a quarter of a second.
    distance = np.where(t <= 0.25, t + 2 * t**2, 0.25 + 2 * 0.25**2 + 2 * (t - 0.25))
    np.testing.assert_allclose(high[0, :, 0], 1.05 + distance, rtol=1e-8)
    np.testing.assert_allclose(low[0, :, 1], 1.95 - distance, rtol=1e-8)
    np.testing.assert_allclose(high[0, :, 2], 3.02 + 2 * t, rtol=1e-8)
    np.testing.assert_allclose(high[0, :, 3], np.minimum(1.0 + 4 * t, 2), rtol=1e-8)
    np.testing.assert_allclose(low[0, :, 3], np.maximum(0.8 - 4 * t, -1), atol=1e-8)
    np.testing.assert_allclose(low[0, :, 4], -0.4, rtol=1e-8)


def test_a_rate_of_the_position_counts_where_it_is_less() -> None:
    slow = CAR | {"x": {"unit": "m", "rate": 0.5}}
    low, high = boxes(profile(slow), np.array([[0.0, 0, 0, 2, 0]]))
    t = DT * np.arange(1, N + 1)
    np.testing.assert_allclose(high[0, :, 0], 0.05 + 0.5 * t, rtol=1e-8)
    np.testing.assert_allclose(low[0, :, 1], -0.05 - 2 * t, rtol=1e-8)


def test_a_lateral_speed_adds_to_the_way() -> None:
    state = CAR | {"s": {"unit": "m/s", "limits": [-0.3, 0.2]}}
    roles = {"position": ["x", "y"], "heading": "yaw", "speed": "v", "lateral_speed": "s"}
    _, high = boxes(profile(state, roles=roles), np.array([[0.0, 0, 0, 2, 0]]))
    np.testing.assert_allclose(high[0, :, 0], 0.05 + 2.3 * DT * np.arange(1, N + 1), rtol=1e-8)


@pytest.mark.parametrize(
    "state",
    [
        CAR | {"yaw": {"unit": "rad", "angle": True}},
        CAR | {"yaw": {"unit": "rad", "angle": True, "limits": [-3.2, 3.2]}},
        CAR | {"v": "m/s"},
        CAR | {"s": "rad"},
    ],
)
def test_a_state_that_nothing_bounds_leaves_no_set(state: dict[str, object]) -> None:
    assert limit_sets(profile(state), np.zeros((3, 5)), N) is None


def test_without_a_role_the_position_needs_its_own_rate() -> None:
    assert limit_sets(profile(roles={}), np.zeros((3, 5)), N) is None
    assert limit_sets(profile(CAR | {"x": {"unit": "m", "rate": 1.0}}, roles={}), np.zeros((3, 5)), N) is None
    both = CAR | {"x": {"unit": "m", "rate": 1.0}, "y": {"unit": "m", "limits": [-5, 5]}}
    low, high = boxes(profile(both, roles={}), np.zeros((3, 5)))
    assert (high[:, -1, 0] < 0.9).all()
    np.testing.assert_allclose(low[:, :, 1], -5)


def test_limits_that_the_received_state_proves_wrong_do_not_cut() -> None:
    x = np.array([[0.0, 0, 0, 2.05, 0], [0.0, 0, 0, 2.5, 0.6]])
    found = limit_sets(profile(), x, N)
    assert found is not None
    half = np.abs(found[1]).sum(axis=-1)
    assert np.isfinite(half[0]).all()
    assert np.isinf(half[1, :, 4]).all(), "its limits were all that bounded it"
    t = DT * np.arange(1, N + 1)
    np.testing.assert_allclose(half[0, :, 0], 0.05 + 2 * t, rtol=1e-8)
    np.testing.assert_allclose(half[1, :, 0], 0.05 + 2.6 * t + 2 * t**2, rtol=1e-8)
    np.testing.assert_allclose(half[1, :, 3], 0.1 + 4 * t, rtol=1e-8)
    assert limit_sets(profile(), x[1:], N) is None


def test_no_vehicles_get_no_sets() -> None:
    found = limit_sets(profile(), np.zeros((0, 5)), N)
    assert found is not None
    assert found[0].shape == (0, N, 5)
