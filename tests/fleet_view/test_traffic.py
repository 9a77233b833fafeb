"""Messages and bytes by key over a sliding window, against a count of every message."""

import numpy as np
import pytest

from fleet_bus import keys
from fleet_view.traffic import Traffic, kind_of
from tests.examples import generator


def test_rates_are_those_of_the_window() -> None:
    traffic = Traffic(window=10.0)
    rng = generator("traffic")
    sent: list[tuple[float, str, int]] = []
    now = 1000.0
    for _ in range(2000):
        now += float(rng.exponential(0.05))
        key = f"fleet/car{rng.integers(3)}/state"
        size = int(rng.integers(1, 500))
        sent.append((now, key, size))
        traffic.count(key, size, now)
    names = [f"fleet/car{i}/state" for i in range(4)]
    rates, totals = traffic.flows(names, now)
    # Ten whole buckets and the part of one that has passed.
    seconds = 10.0 + now % 1.0
    for i, name in enumerate(names):
        sizes = [size for t, key, size in sent if key == name and t >= now - seconds]
        assert rates[i] == pytest.approx([len(sizes) / seconds, sum(sizes) / seconds])
        assert totals[i].tolist() == [
            sum(key == name for _, key, _ in sent), sum(size for _, key, size in sent if key == name)
        ]  # fmt: skip
    assert rates[3].tolist() == [0.0, 0.0]
    total = traffic.total(now)
    assert total.messages == 2000
    assert total.bytes == sum(size for _, _, size in sent)
    assert total.bytes_per_second == pytest.approx(rates[:, 1].sum())


def test_before_a_window_has_passed_rates_are_of_what_has() -> None:
    traffic = Traffic(window=10.0)
    for i in range(40):
        traffic.count("reach/a/tube", 100, 5.0 + 0.1 * i)
    assert traffic.total(9.0).messages_per_second == pytest.approx(10.0)
    # One message is no rate.
    fresh = Traffic()
    fresh.count("reach/a/tube", 100, 5.0)
    assert fresh.total(5.0).messages_per_second == 1.0


def test_silence_empties_the_window_and_not_the_total() -> None:
    traffic = Traffic(window=3.0)
    traffic.count("reach/a/tube", 100, 0.5)
    assert traffic.total(2.0).messages_per_second > 0
    assert traffic.total(1e6).messages_per_second == 0
    assert traffic.total(1e6).messages == 1


def test_keys_that_are_forgotten_or_too_many_stay_in_the_total() -> None:
    traffic = Traffic(most=2)
    for name in "abc":
        traffic.count(f"reach/{name}/tube", 10, 1.0)
    traffic.forget(["reach/a/tube", "reach/nobody/tube"])
    total = traffic.total(1.5)
    assert (total.messages, total.bytes) == (3, 30)
    assert set(traffic.by_kind(1.5)) == {"tube"}
    assert traffic.by_kind(1.5)["tube"].messages == 1
    rates, totals = traffic.flows(["reach/a/tube"], 1.5)
    assert not np.any(rates)
    assert not np.any(totals)


def test_kinds_of_keys() -> None:
    found = {
        kind_of(key)
        for key in (
            keys.state("a"), keys.truth("a"), keys.profile("a"), keys.document("s"), keys.assignment("s", "a"),
            keys.tube("a"), keys.event("a"), keys.service_status("reach", "r"), keys.service_event("reach", "r"),
        )
    }  # fmt: skip
    assert found == {"state", "truth", "profile", "document", "assignment", "tube", "event", "status"}
    assert {kind_of(key) for key in ("", "fleet/a", "x/a/tube", "reach/a/tube/b/c", "fleet/a/nothing")} == {"other"}
