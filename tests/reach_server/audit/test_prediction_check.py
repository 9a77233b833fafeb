"""Measured states against predicted sets: modulo whole turns, enlarged by the noise, each prediction once."""

import math

import numpy as np
import pytest

from reach_server.audit.prediction_check import FEW, RECENT, Predictions, bands, binomial_band, inside, times_as_far
from reach_server.data.window import SampleBatch
from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray
from reach_server.sets.raw import RawSets

NONE = np.zeros((2, 0))


def boxes(half: FloatArray) -> RawSets:
    """Boxes (B, 2) around the origin."""
    return RawSets.zonotope(np.zeros(half.shape), half[..., None] * np.eye(2))


def test_points_are_judged_against_the_set_and_the_noise() -> None:
    sets = boxes(np.ones((4, 2)))
    y = np.array([[0.9, -0.9], [1.05, 0.0], [1.2, 0.0], [0.0, -4.0]])
    held, excess = inside(sets, np.diag([0.1, 0.1]), y, ())
    np.testing.assert_array_equal(held, [True, True, False, False])
    np.testing.assert_allclose(excess, [0, 0, 0.1, 2.9])
    np.testing.assert_array_equal(inside(sets, NONE, y, ())[0], [True, False, False, False])


def test_angles_are_compared_modulo_whole_turns() -> None:
    sets = RawSets.zonotope(np.array([[0.0, 3.1]]), 0.2 * np.eye(2)[None])
    for angle in (3.2, 3.2 - 2 * np.pi, 3.2 + 8 * np.pi):
        assert inside(sets, NONE, np.array([[0.0, angle]]), (1,))[0].all()
    held, excess = inside(sets, NONE, np.array([[0.0, -2.5]]), (1,))
    assert not held.any()
    assert excess[0] == pytest.approx(2 * np.pi - 2.5 - 3.3)


def test_constraints_count() -> None:
    half_plane = RawSets(np.zeros((1, 2)), np.eye(2)[None], np.array([[[1.0, 1.0]]]), np.array([[1.5]]))
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


def checked(predictions: Predictions, batch: SampleBatch) -> list[tuple[int, int, bool, float, bool]]:
    found = predictions.check(batch, 30.0, NONE, ())
    columns = (found.row, found.slot, found.inside, found.excess, found.inside_free)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def test_a_prediction_is_checked_once_by_the_sample_it_was_made_for() -> None:
    predictions = Predictions()
    assert checked(predictions, sample(0, 1)) == []
    predicted(predictions, [0, 2], 5, 0.5, 1.0)
    for other in (
        sample(0, 7), sample(0, 6, t=650), sample(0, 6, epoch=2), sample(0, 6, flags=2), sample(1, 6),
        sample(0, 6, x=np.nan),
    ):  # fmt: skip
        assert checked(predictions, other) == []
    batch = SampleBatch.join([sample(2, 6, x=0.75), sample(0, 6, x=0.1), sample(0, 6, x=0.1), sample(9, 6)])
    assert checked(predictions, batch) == [(1, 0, True, 0.0, True), (0, 2, False, 0.25, True)]
    assert checked(predictions, batch) == []


def test_a_sample_off_its_time_is_held_against_the_set_without_cuts() -> None:
    predictions = Predictions()
    predicted(predictions, [0, 1], 5, 0.5, 1.0)
    batch = SampleBatch.join([sample(0, 6, x=0.75, t=610), sample(1, 6, x=1.5, t=610)])
    assert checked(predictions, batch) == [(0, 0, True, 0.0, True), (1, 1, False, 0.5, False)]


def test_the_newest_prediction_replaces_the_one_before() -> None:
    predictions = Predictions()
    predicted(predictions, [0, 1], 5, 0.5, 0.5)
    predicted(predictions, [1], 6, 0.5, 0.5)
    assert [one[1] for one in checked(predictions, SampleBatch.join([sample(1, 6), sample(0, 6)]))] == [0]
    assert [one[1] for one in checked(predictions, sample(1, 7, x=9.0))] == [1]


def test_a_dropped_prediction_is_not_checked() -> None:
    predictions = Predictions()
    predicted(predictions, [0, 1], 5, 0.5, 0.5)
    predictions.drop(0)
    predictions.drop(7)
    batch = SampleBatch.join([sample(0, 6), sample(1, 6)])
    assert [one[1] for one in checked(predictions, batch)] == [1]


def test_sets_of_other_sizes_do_not_disturb_those_that_wait() -> None:
    """Three vehicles, whose sets have one, three and two generators and a constraint in the middle one."""
    predictions = Predictions()
    one = RawSets.zonotope(np.zeros((1, 2)), np.array([[[1.0], [0.0]]]))
    half = RawSets(np.zeros((1, 2)), np.c_[np.eye(2), np.ones(2)][None], np.ones((1, 1, 3)), np.array([[2.5]]))

    def keep(slots: list[int], sets: RawSets) -> None:
        count = len(slots)
        seq = np.full(count, 5, dtype=np.uint64)
        predictions.keep(
            np.array(slots, dtype=np.intp), np.ones(count, dtype=np.uint64), seq, np.full(count, 600), sets, sets
        )

    for slot, sets in enumerate((one, half, boxes(np.ones((1, 2))), one)):
        keep([slot], sets)
    keep([1], half)
    keep([], take_rows(one, []))
    points = [0.9, 0.0, 0.9, 1.1]
    found = checked(predictions, SampleBatch.join([sample(slot, 6, x=x) for slot, x in enumerate(points)]))
    assert [one[2] for one in found] == [True, False, True, False]
    keep([1], one)
    assert checked(predictions, sample(1, 6, x=0.9))[0][2], "constraints of an earlier set are gone"


@pytest.mark.parametrize(
    ("checks", "alpha", "band"), [(1000, 0.01, 18), (100, 0.01, 4), (0, 0.01, 0), (1, 0.01, 0), (3, 0.9, 3), (50, 0, 0)]
)
def test_a_band_is_the_least_that_holds_ninety_nine_of_a_hundred(checks: int, alpha: float, band: int) -> None:
    assert binomial_band(checks, alpha) == band
    reached = sum(math.comb(checks, k) * alpha**k * (1 - alpha) ** (checks - k) for k in range(band + 1))
    below = reached - math.comb(checks, band) * alpha**band * (1 - alpha) ** (checks - band)
    assert reached >= 0.99 - 1e-12
    assert band == 0 or below < 0.99


def test_few_checks_say_little() -> None:
    leaves, returns = bands(0.01)
    assert len(leaves) == len(returns) == RECENT + 1
    assert leaves[[1, 5, 10, FEW - 1]].tolist() == [1, 2, 3, 5]
    assert leaves[[FEW, 1000]].tolist() == [3, 18]
    assert returns[[FEW, 1000]].tolist() == [0, 10]
    assert (returns <= leaves).all()


def test_how_many_times_as_far_as_its_set_a_state_lies() -> None:
    sets = RawSets.zonotope(np.array([[1.0, 3.0]] * 4), np.tile(np.diag([0.4, 0.1]), (4, 1, 1)))
    y = np.array([[1.0, 3.0], [2.0, 3.0], [1.25, 3.0 - 2 * np.pi + 0.6], [1.0, 3.1]])
    found = times_as_far(sets, np.diag([0.1, 0.1]), y, (1,))
    np.testing.assert_allclose(found, [0.0, 2.0, 3.0, 0.5], atol=1e-12)
    flat = RawSets.zonotope(np.zeros((1, 2)), np.zeros((1, 2, 0)))
    assert times_as_far(flat, NONE, np.array([[0.1, 0.0]]), ())[0] == np.inf
