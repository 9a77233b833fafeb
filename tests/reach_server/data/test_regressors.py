"""Regression data against loops that do one thing at a time."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from reach_server.data.regressors import (
    RegressorSpec,
    increments,
    inputs_known,
    lagged_inputs,
    rotate,
    runs,
    transitions,
    unwrapped,
    wrap,
)
from reach_server.data.window import Block
from reach_server.numeric.types import FloatArray
from tests.reach_server.drives import LAYOUT, PROFILE, START
from tests.reach_server.ugly import moderate


def random_block(seed: int, size: int = 30) -> Block:
    """A car that turns a lot, in broken trajectories, with unknown inputs and an empty front."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(2, size, 4))
    x[..., 2] = wrap(np.cumsum(rng.uniform(-1.5, 2.5, (2, size)), axis=1))
    valid = np.arange(size) >= rng.integers(0, 5, (2, 1))
    linked = (rng.random((2, size)) < 0.8) & valid
    linked[:, 0] = False
    linked[:, 1:] &= valid[:, :-1]
    known = valid & (rng.random((2, size)) < 0.9)
    t = np.broadcast_to(START + np.arange(size), (2, size))
    return Block(t, x * valid[..., None], rng.normal(size=(2, size, 2)), valid, known, linked)


def twin_runs(linked: NDArray[np.bool_]) -> NDArray[np.int64]:
    found = np.zeros(linked.shape, dtype=np.int64)
    for b in range(len(linked)):
        for k in range(1, linked.shape[1]):
            found[b, k] = found[b, k - 1] + 1 if linked[b, k] else 0
    return found


def twin_unwrapped(block: Block) -> FloatArray:
    x = block.x.copy()
    for b in range(len(x)):
        for k in range(x.shape[1]):
            if not block.linked[b, k]:
                x[b, k, 2] = (x[b, k, 2] + np.pi) % (2 * np.pi) - np.pi
            else:
                turn = block.x[b, k, 2] - block.x[b, k - 1, 2]
                x[b, k, 2] = x[b, k - 1, 2] + np.arctan2(np.sin(turn), np.cos(turn))
    return x


@moderate
@given(st.integers(0, 2**32 - 1))
def test_runs_angles_and_lags_agree_with_loops(seed: int) -> None:
    block = random_block(seed)
    np.testing.assert_array_equal(runs(block.linked), twin_runs(block.linked))
    x = unwrapped(block, LAYOUT)
    np.testing.assert_allclose(x, twin_unwrapped(block), atol=1e-9)
    d = increments(x, LAYOUT)
    data = transitions(block, LAYOUT)
    lagged = lagged_inputs(block, LAYOUT)
    for b in range(2):
        for k in range(29):
            run = twin_runs(block.linked)[b, k]
            world = x[b, k + 1] - x[b, k]
            c, s = np.cos(x[b, k, 2]), np.sin(x[b, k, 2])
            expected = [c * world[0] + s * world[1], -s * world[0] + c * world[1], world[2], world[3]]
            np.testing.assert_allclose(d[b, k], expected, atol=1e-9)
            complete = run >= 2 and all(block.input_known[b, k - lag] for lag in range(3))
            assert bool(inputs_known(block, runs(block.linked), LAYOUT)[b, k]) == (complete and bool(block.valid[b, k]))
            usable = bool(data.usable[b, k])
            assert usable == (complete and bool(block.valid[b, k]) and bool(block.linked[b, k + 1]))
            if usable:
                past = np.concatenate([block.u[b, k - lag] for lag in range(3)])
                np.testing.assert_array_equal(lagged[b, k], past)
                np.testing.assert_array_equal(data.z[b, k], np.concatenate([block.x[b, k, [3]], past]))
                np.testing.assert_allclose(data.target[b, k], expected, atol=1e-9)
        assert not data.usable[b, -1]


@moderate
@given(st.integers(0, 2**32 - 1))
def test_world_targets_are_the_next_states(seed: int) -> None:
    block = random_block(seed)
    layout = RegressorSpec.of(PROFILE, "world")
    data = transitions(block, layout)
    x = twin_unwrapped(block)
    for b, k in zip(*np.nonzero(data.usable), strict=True):
        np.testing.assert_allclose(data.target[b, k], x[b, k + 1], atol=1e-9)
        np.testing.assert_allclose(data.z[b, k, :4], x[b, k], atol=1e-9)


def test_a_car_that_circles_has_a_heading_that_goes_on() -> None:
    true: FloatArray = 0.4 * np.arange(60.0) - 3.0
    x = np.zeros((1, 60, 4))
    x[0, :, 2] = wrap(true)
    linked = np.arange(60)[None] > 0
    yes = np.ones((1, 60), dtype=bool)
    block = Block(np.arange(60)[None], x, np.zeros((1, 60, 2)), yes, yes, linked)
    np.testing.assert_allclose(unwrapped(block, LAYOUT)[0, :, 2], true, atol=1e-9)
    np.testing.assert_allclose(increments(unwrapped(block, LAYOUT), LAYOUT)[0, :-1, 2], 0.4, atol=1e-9)


def test_layouts_of_both_frames() -> None:
    body, world = RegressorSpec.of(PROFILE), RegressorSpec.of(PROFILE, "world")
    assert (body.pose, body.free, body.angles, body.regressors) == ((0, 1, 2), (3,), (2,), 7)
    assert (world.pose, world.free, world.regressors) == (None, (0, 1, 2, 3), 10)


def test_wrapping_and_turning() -> None:
    angles = np.array([-np.pi, np.pi, 3 * np.pi, 0.0, 7.0])
    assert ((wrap(angles) >= -np.pi) & (wrap(angles) < np.pi)).all()
    np.testing.assert_allclose(np.exp(1j * wrap(angles)), np.exp(1j * angles), atol=1e-12)
    np.testing.assert_allclose(rotate(np.array(np.pi / 2), np.array([1.0, 0.0])), [0.0, 1.0], atol=1e-12)
