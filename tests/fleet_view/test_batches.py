"""How long batches took, from the tubes alone."""

import math

import pytest

from fleet_view.batches import Batches


def test_tubes_of_one_time_are_one_batch() -> None:
    batches = Batches(window=10.0)
    now = 0.0
    for seconds, tubes in ((0.5, 2), (0.004, 4), (0.006, 6), (0.1, 3)):
        for _ in range(tubes):
            batches.tube(seconds, now)
        now += 1.0
    # Not the first, of which some tubes may have come before; not the last, of which some may come yet.
    found = batches.compute(now)
    assert found.batch == pytest.approx(0.005)
    assert found.tubes == pytest.approx(5.0)
    assert found.tube == pytest.approx(0.001)
    assert math.isnan(batches.compute(100.0).batch)


def test_a_batch_of_which_tubes_were_passed_over_does_not_count() -> None:
    batches = Batches(window=10.0)
    for seconds in (0.1, 0.2, 0.2):
        batches.tube(seconds, 0.0)
    batches.gap()
    for seconds in (0.2, 0.3, 0.4):
        batches.tube(seconds, 0.0)
    found = batches.compute(0.0)
    assert (found.batch, found.tubes) == (0.3, 1.0)
