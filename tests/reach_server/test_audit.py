"""Measured states against predicted sets: modulo whole turns, enlarged by the noise, each prediction once."""

import numpy as np
import pytest

from reach_server.audit import Predictions, inside
from reach_server.factor_sets import FactorSet
from reach_server.rows import take
from reach_server.windows import Floats, SampleBatch

NONE = np.zeros((2, 0))


def boxes(half: Floats) -> FactorSet:
    """Boxes (B, 2) around the origin."""
    return FactorSet.zonotope(np.zeros(half.shape), half[..., None] * np.eye(2))


def test_points_are_judged_against_the_set_and_the_noise() -> None:
    sets = boxes(np.ones((4, 2)))
    y = np.array([[0.9, -0.9], [1.05, 0.0], [1.2, 0.0], [0.0, -4.0]])
    held, excess = inside(sets, np.diag([0.1, 0.1]), y, ())
    np.testing.assert_array_equal(held, [True, True, False, False])
    np.testing.assert_allclose(excess, [0, 0, 0.1, 2.9])
    np.testing.assert_array_equal(inside(sets, NONE, y, ())[0], [True, False, False, False])


def test_angles_are_compared_modulo_whole_turns() -> None:
    sets = FactorSet.zonotope(np.array([[0.0, 3.1]]), 0.2 * np.eye(2)[None])
    for angle in (3.2, 3.2 - 2 * np.pi, 3.2 + 8 * np.pi):
        assert inside(sets, NONE, np.array([[0.0, angle]]), (1,))[0].all()
    held, excess = inside(sets, NONE, np.array([[0.0, -2.5]]), (1,))
    assert not held.any()
    assert excess[0] == pytest.approx(2 * np.pi - 2.5 - 3.3)


def test_constraints_count() -> None:
    half_plane = FactorSet(np.zeros((1, 2)), np.eye(2)[None], np.array([[[1.0, 1.0]]]), np.array([[1.5]]))
    assert inside(half_plane, NONE, np.array([[0.75, 0.75]]), ())[0].all()
    held, excess = inside(half_plane, NONE, np.array([[0.0, 0.0]]), ())
    assert not held.any()
    assert excess[0] == 0.0


def sample(slot: int, seq: int, *, t: int | None = None, x: float = 0.0, epoch: int = 1, flags: int = 0) -> SampleBatch:
    return SampleBatch(
        np.array([slot]), np.array([epoch], dtype=np.uint64), np.array([seq], dtype=np.uint64),
        np.array([100 * seq if t is None else t]), np.array([flags], dtype=np.uint32), np.array([[x, 0.0]]),
        np.zeros((1, 1)),
    )  # fmt: skip


def predicted(predictions: Predictions, slots: list[int], seq: int, cut: float, free: float) -> None:
    count = len(slots)
    predictions.keep(
        np.array(slots), np.ones(count, dtype=np.uint64), np.full(count, seq, dtype=np.uint64),
        np.full(count, 100 * (seq + 1)), boxes(np.full((count, 2), cut)), boxes(np.full((count, 2), free)),
    )  # fmt: skip


def test_a_prediction_is_checked_once_by_the_sample_it_was_made_for() -> None:
    predictions = Predictions()
    predicted(predictions, [0, 2], 5, 0.5, 1.0)
    for other in (sample(0, 7), sample(0, 6, t=650), sample(0, 6, epoch=2), sample(0, 6, flags=2), sample(1, 6)):
        assert not predictions.check(other, 30.0, NONE, ())
    batch = SampleBatch.join([sample(2, 6, x=0.75), sample(0, 6, x=0.1), sample(0, 6, x=0.1), sample(9, 6)])
    found = sorted(predictions.check(batch, 30.0, NONE, ()), key=lambda one: one[1])
    assert found == [(1, 0, True, 0.0, True), (0, 2, False, 0.25, True)]
    assert not predictions.check(batch, 30.0, NONE, ())


def test_the_newest_prediction_replaces_the_one_before() -> None:
    predictions = Predictions()
    predicted(predictions, [0, 1], 5, 0.5, 0.5)
    predicted(predictions, [1], 6, 0.5, 0.5)
    assert [one[1] for one in predictions.check(SampleBatch.join([sample(1, 6), sample(0, 6)]), 30.0, NONE, ())] == [0]
    assert [one[1] for one in predictions.check(sample(1, 7, x=9.0), 30.0, NONE, ())] == [1]


def test_a_dropped_prediction_is_not_checked() -> None:
    predictions = Predictions()
    predicted(predictions, [0, 1], 5, 0.5, 0.5)
    predictions.drop(0)
    predictions.drop(7)
    batch = SampleBatch.join([sample(0, 6), sample(1, 6)])
    assert [one[1] for one in predictions.check(batch, 30.0, NONE, ())] == [1]
    assert take(batch, [0]).x.shape == (1, 2)
