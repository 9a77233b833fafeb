"""The set of now: what was received, cut by what was predicted."""

import numpy as np
import pytest

from reach_server.data.regressors import RegressorSpec
from reach_server.methods.request import Prior, TubeRequest
from reach_server.methods.set_membership import received
from reach_server.models.residual_model import NoiseBounds
from reach_server.numeric.types import FloatArray
from reach_server.sets.raw import RawSets
from tests.reach_server.drives import LAYOUT, PROFILE, START, block_of

BOUNDS = NoiseBounds(np.zeros((4, 0)), np.diag([0.1, 0.1, 0.05, 0.2]))
STATE = np.array([1.0, 2.0, 3.1, 0.5])


def served(prior: Prior | None) -> TubeRequest:
    block = block_of(np.repeat(STATE[None], 3, axis=0), np.zeros((3, 2)))
    one = np.ones(1, dtype=np.uint64)
    return TubeRequest(np.zeros(1, dtype=np.intp), one, one, np.array([START]), block, None, prior)


def start(center: list[float], half: list[float], layout: RegressorSpec = LAYOUT) -> tuple[FloatArray, FloatArray]:
    sets = RawSets.zonotope(np.array([center]), np.diag(half)[None])
    found = received(served(Prior(np.array([0]), sets)), layout, BOUNDS, STATE[None])
    reach = np.abs(found.generators[0]).sum(axis=1)
    return found.center[0] - reach, found.center[0] + reach


def test_without_a_prediction_it_is_the_received_state_and_its_noise() -> None:
    found = received(served(None), LAYOUT, BOUNDS, STATE[None])
    np.testing.assert_allclose(found.center[0], STATE, rtol=1e-15)
    np.testing.assert_array_equal(found.generators[0], BOUNDS.measurement)


def test_it_is_the_intersection_with_the_box_of_the_prediction() -> None:
    low, high = start([1.05, 2.0, 3.1, 0.6], [0.05, 9.0, 9.0, 0.02])
    np.testing.assert_allclose(low, [1.0, 1.9, 3.05, 0.58], atol=1e-9)
    np.testing.assert_allclose(high, [1.1, 2.1, 3.15, 0.62], atol=1e-9)


@pytest.mark.parametrize("frame", ["body", "world"])
def test_a_heading_in_another_turn_is_the_same_heading(frame: str) -> None:
    low, high = start([1.0, 2.0, 3.12 - 2 * np.pi, 0.5], [9.0, 9.0, 0.01, 9.0], RegressorSpec.of(PROFILE, frame))
    np.testing.assert_allclose([low[2], high[2]], [3.11, 3.13], atol=1e-9)


def test_a_received_state_that_the_prediction_excludes_is_taken_alone() -> None:
    low, high = start([5.0, 2.0, 3.1, 0.5], [0.1, 9.0, 9.0, 9.0])
    np.testing.assert_allclose([low[0], high[0]], [0.9, 1.1])
