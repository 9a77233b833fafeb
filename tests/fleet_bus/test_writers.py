"""One writer a key: who may follow, and what two at once are."""

import numpy as np
import pytest

from fleet_bus.writers import Change, Source, Turn, Writer

A, B, C = Source("a", 1), Source("b", 2), Source("c", 3)
PATIENCE, LEAVE = 0.5, 2.0


def judge(writer: Writer, source: Source, now: float, count: int = 1) -> tuple[Turn, Change]:
    return writer.judge(source, count, now, PATIENCE, LEAVE)


def test_the_first_source_writes_and_goes_on() -> None:
    writer = Writer()
    assert [judge(writer, A, t) for t in (0.0, 0.1, 99.0)] == [(Turn.ACCEPT, Change.NONE)] * 3
    assert not writer.conflict


def test_a_start_that_follows_a_silent_one_takes_over_at_once() -> None:
    writer = Writer()
    judge(writer, A, 0.0)
    assert judge(writer, B, PATIENCE + 0.01) == (Turn.ACCEPT, Change.TAKEN_OVER)
    assert writer.source == B


def test_a_start_that_follows_within_a_moment_is_held_until_the_first_has_been_silent() -> None:
    writer = Writer()
    judge(writer, A, 0.0)
    assert judge(writer, B, 0.1, 1000) == (Turn.HOLD, Change.NONE)
    assert judge(writer, B, 0.3) == (Turn.HOLD, Change.NONE)
    assert writer.elapse(PATIENCE, PATIENCE, LEAVE) is Change.NONE
    assert writer.elapse(PATIENCE + 0.01, PATIENCE, LEAVE) is Change.TAKEN_OVER
    assert judge(writer, B, 0.6) == (Turn.ACCEPT, Change.NONE)


def test_two_that_go_on_are_a_conflict_until_one_has_left() -> None:
    writer = Writer()
    changes = []
    for k in range(40):
        changes.append(judge(writer, A, k * 0.1)[1])
        turn, change = judge(writer, B, k * 0.1 + 0.05)
        assert turn is Turn.HOLD
        changes.append(change)
    assert changes.count(Change.CONFLICT) == 1
    assert set(changes) == {Change.NONE, Change.CONFLICT}
    assert writer.conflict
    # The second one leaves.
    for k in range(40, 59):
        assert judge(writer, A, k * 0.1) == (Turn.ACCEPT, Change.NONE)
    assert judge(writer, A, 6.0) == (Turn.ACCEPT, Change.STAYED)
    assert not writer.conflict


def test_of_two_the_first_may_be_the_one_that_leaves() -> None:
    writer = Writer()
    for k in range(5):
        judge(writer, A, k * 0.1)
        judge(writer, B, k * 0.1)
    assert writer.conflict
    assert judge(writer, B, 0.4 + LEAVE) == (Turn.HOLD, Change.NONE)
    assert judge(writer, B, 0.41 + LEAVE) == (Turn.ACCEPT, Change.LOST)
    assert (writer.source, writer.rival, writer.conflict) == (B, None, False)


def test_a_stray_message_is_no_second_writer() -> None:
    writer = Writer()
    judge(writer, A, 0.0)
    assert judge(writer, B, 0.05) == (Turn.HOLD, Change.NONE)
    changes = [judge(writer, A, 0.1 * k)[1] for k in range(1, 40)]
    assert set(changes) == {Change.NONE, Change.DISMISSED}
    assert writer.rival is None


def test_a_third_source_is_refused_while_two_are_there_and_may_follow_later() -> None:
    writer = Writer()
    judge(writer, A, 0.0)
    judge(writer, B, 0.1)
    assert judge(writer, C, 0.2) == (Turn.REFUSE, Change.NONE)
    judge(writer, A, 2.0)
    assert judge(writer, C, 2.2) == (Turn.HOLD, Change.NONE)
    assert writer.rival == C


@pytest.mark.parametrize("seed", range(20))
def test_whoever_is_left_alone_writes_in_the_end(seed: int) -> None:
    rng = np.random.default_rng(seed)
    writer, now = Writer(), 0.0
    for _ in range(200):
        now += float(rng.exponential(0.2))
        judge(writer, (A, B, C)[rng.integers(3)], now, int(rng.integers(1, 5)))
        writer.elapse(now, PATIENCE, LEAVE)
    left = (A, B, C)[rng.integers(3)]
    for _ in range(100):
        now += 0.1
        turn, _ = judge(writer, left, now)
        writer.elapse(now, PATIENCE, LEAVE)
    assert turn is Turn.ACCEPT
    assert (writer.source, writer.conflict) == (left, False)
