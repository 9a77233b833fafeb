"""Counting refusals, and not drowning the log in them."""

import threading

from structlog.testing import capture_logs

from fleet_bus.codec import REASONS
from fleet_bus.errors import MessageError
from fleet_bus.rejections import Rejections


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_refusals_are_counted_by_reason() -> None:
    rejections = Rejections()
    for reason in (*REASONS, "shape"):
        rejections.count(MessageError(reason, "x"), "fleet/a/state")
    assert rejections.snapshot() == {reason: 1 + (reason == "shape") for reason in REASONS}


def test_a_snapshot_is_a_copy() -> None:
    rejections = Rejections()
    rejections.snapshot()["shape"] = 7
    assert rejections.snapshot() == {}


def test_the_first_refusal_is_logged_then_at_most_one_a_second_with_how_many_there_were() -> None:
    clock = Clock()
    rejections = Rejections(clock)
    with capture_logs() as logs:
        for _ in range(5):
            rejections.count(MessageError("shape", "too short"), "fleet/a/state")
        clock.now += 0.999
        rejections.count(MessageError("shape", "too short"), "fleet/a/state")
        clock.now += 0.001
        rejections.count(MessageError("fields", "missing"), "k" * 500)
    assert [log["refused"] for log in logs] == [1, 6]
    assert (logs[0]["key"], logs[0]["reason"], logs[0]["detail"]) == ("fleet/a/state", "shape", "too short")
    assert logs[1]["key"] == "k" * 120


def test_no_refusal_is_lost_between_threads() -> None:
    rejections = Rejections(Clock())

    def work() -> None:
        for _ in range(2000):
            rejections.count(MessageError("shape", "x"), "k")

    with capture_logs():
        threads = [threading.Thread(target=work) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert rejections.snapshot() == {"shape": 16_000}
