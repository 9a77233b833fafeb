"""When a server puts its journal and checkpoints: while somebody records, and for each who comes."""

import pytest

from fleet_bus import keys
from fleet_bus.messages import CheckpointPart, JournalRound
from fleet_bus.rejections import Rejections
from reach_server.service.fleet import Fleet
from reach_server.service.recording import INTERVAL, LINGER, Recording
from tests.memory_bus import Network
from tests.reach_server.drives import PROFILE, START


class Rounds:
    """A server that does nothing but write its rounds down."""

    def __init__(self) -> None:
        self.network = Network()
        self.recording = Recording("one", START)
        self.recording.open(self.network.bus())
        self.fleet = Fleet(Rejections())
        self.now = 0.0

    def one(self, seconds: float = 0.02) -> list[str]:
        """What a round puts, by the last part of its keys."""
        self.network.puts.clear()
        self.now += seconds
        self.recording.journal.begin(self.now, START)
        self.recording.journal.gone("a")
        self.recording.end(self.fleet, self.now)
        return [message.key.rpartition("/")[2] for message in self.network.puts]


def test_nothing_is_put_while_nobody_records_and_the_chain_is_kept() -> None:
    rounds = Rounds()
    assert rounds.one() == rounds.one() == []
    assert rounds.recording.journal.number == 2
    assert rounds.recording.journal.summary()["round"] == "2"


def test_who_comes_gets_a_checkpoint_and_the_rounds_from_there_on() -> None:
    rounds = Rounds()
    rounds.one()
    rounds.recording.token("svc/recorder/x", True)
    assert rounds.one() == ["checkpoint"]
    part = CheckpointPart.decode(rounds.network.puts[0].payload)
    assert (part.number, part.chain) == (2, rounds.recording.journal.chain)
    assert rounds.network.puts[0].key == keys.checkpoint("one")
    assert rounds.one() == ["journal"]
    assert JournalRound.decode(rounds.network.puts[0].payload).number == 3
    # Another one comes: a checkpoint for it, and no round is left out for the first.
    rounds.recording.token("svc/recorder/y", True)
    assert rounds.one(INTERVAL) == ["journal", "checkpoint"]
    assert rounds.one() == ["journal"]


def test_the_journal_goes_on_for_a_while_when_the_last_recorder_is_gone() -> None:
    rounds = Rounds()
    rounds.recording.token("svc/recorder/x", True)
    rounds.one()
    rounds.recording.token("svc/recorder/x", False)
    assert rounds.one() == ["journal"]
    assert rounds.one(LINGER) == ["journal"]
    assert rounds.one() == []


def test_many_recorders_do_not_hold_up_the_rounds() -> None:
    rounds, put = Rounds(), 0
    for k in range(50):
        rounds.recording.token(f"svc/recorder/{k}", True)
        put += rounds.one(INTERVAL / 10).count("checkpoint")
    assert 5 <= put <= 6
    assert rounds.one(INTERVAL).count("checkpoint") == 1


def test_a_large_state_comes_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("reach_server.service.checkpoint.PART_BYTES", 1000)
    rounds = Rounds()
    rounds.fleet.set_profile("a", PROFILE)
    rounds.recording.token("svc/recorder/x", True)
    assert set(rounds.one()) == {"checkpoint"}
    parts = [CheckpointPart.decode(message.payload) for message in rounds.network.puts]
    assert len(parts) > 2
    assert [part.part for part in parts] == [(k + 1, len(parts)) for k in range(len(parts))]
    assert b"".join(part.data for part in parts) == rounds.fleet.snapshot()


def test_what_cannot_be_put_is_told_and_ends_nothing() -> None:
    rounds = Rounds()
    rounds.fleet.odd = object()  # type: ignore[attr-defined]
    rounds.recording.token("svc/recorder/x", True)
    assert rounds.one() == []
    assert "cannot be restored" in rounds.recording.problems[0]
    del rounds.fleet.odd  # type: ignore[attr-defined]
    rounds.recording.token("svc/recorder/x", True)
    rounds.network.broken = OSError("gone")
    rounds.one(INTERVAL)
    assert "gone" in rounds.recording.problems[0]
    rounds.network.broken = None
    rounds.recording.token("svc/recorder/x", True)
    assert rounds.one(INTERVAL) == ["journal", "checkpoint"]
    assert rounds.recording.problems == []
