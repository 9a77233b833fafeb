"""The state of a fleet between two rounds, as messages and back: where the replay of a journal can begin."""

from collections.abc import Callable, Iterator, Sequence
from hashlib import blake2b

from fleet_bus.messages import CheckpointPart
from fleet_bus.messages.checkpoint import PART_BYTES
from fleet_bus.rejections import Rejections
from reach_server.service.build import build
from reach_server.service.fleet import Fleet
from reach_server.service.journal import Journal
from reach_server.service.object_graph import CheckpointError


def _digest(state: bytes) -> str:
    return blake2b(state, digest_size=16).hexdigest()


def parts(server: str, started: int, fleet: Fleet, journal: Journal) -> Iterator[CheckpointPart]:
    """The state of a fleet after the newest round of its journal. Raises ``CheckpointError`` for what cannot be
    written."""
    state = fleet.snapshot()
    digest, count = _digest(state), max(1, -(-len(state) // PART_BYTES))
    for part in range(count):
        yield CheckpointPart(
            server, started, build(), journal.number, journal.chain, digest, (part + 1, count),
            state[part * PART_BYTES : (part + 1) * PART_BYTES],
        )  # fmt: skip


def restored(found: Sequence[CheckpointPart], stamp: Callable[[], int]) -> Fleet:
    """The fleet of all parts of a checkpoint, in order; ``stamp`` tells the time of its events from now on. Raises
    ``CheckpointError`` for what was altered, or written by another version of the program."""
    state = b"".join(part.data for part in found)
    if not found or _digest(state) != found[0].digest:
        raise CheckpointError("the checkpoint is not what the server wrote: its digest differs")
    return Fleet.restored(state, Rejections(), stamp)
