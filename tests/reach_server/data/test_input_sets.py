"""Future inputs: every sequence that limits, rates and plans allow lies in the boxes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus.messages import VehicleProfile, parse_profile
from reach_server.data.input_sets import InputSets, future_inputs, limits
from reach_server.numeric.types import FloatArray
from tests.reach_server.ugly import moderate

HORIZON = 6


def profile(kind: str, **spec: object) -> VehicleProfile:
    return parse_profile(
        {
            "class": "c", "state": {"x": "m"}, "sample_time": 0.1, "future_inputs": kind,
            "inputs": {"u": {"unit": "m", "limits": [-1.0, 0.5], "rate": 3.0, **spec}, "w": {"unit": "m",
                       "limits": [0.2, 2.0], "rate": 100.0}},
        }
    )  # fmt: skip


def holds(sets: InputSets, u: FloatArray) -> bool:
    return bool((np.abs(u - sets.center[0]) <= sets.half[0] + 1e-12).all())


@moderate
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_every_sequence_that_obeys_limits_and_rates_lies_in_the_boxes(seed: int, known: bool) -> None:
    rng = np.random.default_rng(seed)
    made = profile("rate")
    low, high = limits(made)
    current = rng.uniform(low, high)
    sets = future_inputs(made, np.zeros((1, 2, 2)), current[None], np.array([known]), HORIZON)
    limited = future_inputs(profile("limits"), np.zeros((1, 2, 2)), current[None], np.array([known]), HORIZON)
    u = [current]
    for _ in range(HORIZON - 1):
        change = rng.choice([-1.0, 1.0, 0.3], 2) * np.array([3.0, 100.0]) * 0.1
        u.append(np.clip(u[-1] + change, low, high))
    assert holds(sets, np.array(u))
    assert holds(limited, np.array(u))
    assert (sets.half <= limited.half + 1e-12).all()
    assert (sets.center - sets.half >= low - 1e-12).all()
    assert (sets.center + sets.half <= high + 1e-12).all()


@pytest.mark.parametrize("current", [-3.0, 2.0])
def test_a_command_beyond_its_limits_comes_back_at_its_own_pace(current: float) -> None:
    made = profile("rate")
    sets = future_inputs(made, np.zeros((1, 0, 2)), np.array([[current, 1.0]]), np.array([True]), HORIZON)
    slow = current + np.sign(-current) * 0.3 * np.arange(HORIZON)
    stuck = np.full(HORIZON, current)
    for u in (slow, stuck):
        assert (u <= (sets.center + sets.half)[0, :, 0] + 1e-12).all()
        assert (u >= (sets.center - sets.half)[0, :, 0] - 1e-12).all()


def test_a_known_input_is_a_point_and_an_unknown_one_anything_within_limits() -> None:
    u = np.array([[0.1, 1.0], [0.1, 1.0]])
    sets = future_inputs(profile("limits"), np.zeros((2, 0, 2)), u, np.array([True, False]), 1)
    np.testing.assert_array_equal(sets.half[0, 0], 0.0)
    np.testing.assert_allclose(sets.center[1, 0] - sets.half[1, 0], [-1.0, 0.2])
    np.testing.assert_allclose(sets.center[1, 0] + sets.half[1, 0], [0.5, 2.0])


def test_a_plan_counts_from_the_next_step_on() -> None:
    plan = np.arange(2.0 * (HORIZON - 1)).reshape(1, HORIZON - 1, 2)
    current, tolerance = np.array([[0.4, 0.5]]), np.array([[0.1, 0.0]])
    sets = future_inputs(profile("plan"), np.ones((1, 2, 2)), current, np.array([True]), HORIZON, plan, tolerance)
    np.testing.assert_allclose(sets.center[0, 0], [0.4, 0.5])
    np.testing.assert_allclose(sets.center[0, 1:], plan[0])
    np.testing.assert_allclose(sets.half[0, 1:], np.broadcast_to([0.1, 0.0], (HORIZON - 1, 2)))
    np.testing.assert_array_equal(sets.past, np.ones((1, 2, 2)))


def test_limits_that_are_not_stated_are_infinite() -> None:
    low, high = limits(profile("plan", limits=None))
    np.testing.assert_array_equal([low, high], [[-np.inf, 0.2], [np.inf, 2.0]])
