"""What a server puts for those who record it: its journal, and a checkpoint when a recorder comes."""

import time
from contextlib import ExitStack
from typing import Final

import structlog

from fleet_bus import keys
from fleet_bus.bus import Bus, Publisher
from fleet_bus.messages import checkpoint as checkpoint_message
from fleet_bus.messages import journal as journal_message
from reach_server.service import checkpoint
from reach_server.service.fleet import Fleet
from reach_server.service.journal import Journal

_log = structlog.get_logger(__name__)

#: Messages of the journal that a recorder can fetch where it missed them.
JOURNAL_CACHE: Final = 256
#: Seconds for which the journal goes on when no recorder is in sight: one that begins another file misses no round.
LINGER: Final = 5.0
#: Seconds between two checkpoints at least, however many recorders come: rounds wait for them.
INTERVAL: Final = 0.5


class Recording:
    """The journal of a server that ``started`` (Unix ns), and who records it, by their tokens.

    The chain is kept all the time. Messages are put from the checkpoint on that the first recorder gets, while one is
    there; each one that comes gets a checkpoint.
    """

    def __init__(self, instance: str, started: int) -> None:
        self.journal = Journal(instance, started, self._put)
        self._instance = instance
        self._started = started
        self._recorders: set[str] = set()
        self._wanted = self._listening = False
        self._heard = self._put_at = -float("inf")
        self._publishers: tuple[Publisher, Publisher] | None = None
        #: Why recordings of now cannot be verified, if so.
        self.problems: list[str] = []

    def open(self, bus: Bus) -> ExitStack:
        """Declare what is put; closing it takes that back."""
        with ExitStack() as opening:
            journal, state = keys.journal(self._instance), keys.checkpoint(self._instance)
            # A recorder that is stuck must not hold up the server: what it misses it fetches.
            self._publishers = (
                opening.enter_context(bus.publisher(journal, journal_message.ENCODING, cache=JOURNAL_CACHE)),
                opening.enter_context(bus.publisher(state, checkpoint_message.ENCODING, cache=1, patient=True)),
            )
            return opening.pop_all()

    def token(self, recorder: str, alive: bool) -> None:
        """The token of a recorder has come or gone."""
        if alive:
            self._recorders.add(recorder)
            self._wanted = True
        else:
            self._recorders.discard(recorder)

    def end(self, fleet: Fleet, now: float) -> None:
        """A round is over at ``now`` (s): write it down, and put a checkpoint for who has come meanwhile."""
        try:
            self.journal.end()
            if self._wanted and now - self._put_at >= INTERVAL:
                self._wanted, self._put_at = False, now
                self.journal.flush()
                self._put_checkpoint(fleet)
                self.problems = []
        except Exception as error:
            # Nobody but recorders is concerned.
            _log.exception("a recorder does not get what it needs")
            self.problems = [f"recordings cannot be verified until a recorder comes anew: {error}"[:300]]
        if self._recorders:
            self._heard = now
        self._listening = now - self._heard <= LINGER

    def _put_checkpoint(self, fleet: Fleet) -> None:
        """Put the state of the fleet; raises ``CheckpointError`` where it cannot be written."""
        assert self._publishers is not None
        began, size = time.perf_counter(), 0
        for part in checkpoint.parts(self._instance, self._started, fleet, self.journal):
            self._publishers[1].put(part.encode())
            size += len(part.data)
        seconds = round(time.perf_counter() - began, 4)
        _log.info("checkpoint put", bytes=size, seconds=seconds, round=self.journal.number)

    def _put(self, payload: bytes) -> None:
        if self._listening and self._publishers is not None:
            self._publishers[0].put(payload)
