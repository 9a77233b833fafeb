"""The rounds of a server computed anew, from its journal and the messages that this names."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

from fleet_bus import keys
from fleet_bus.errors import MessageError
from fleet_bus.messages import Assignment, CheckpointPart, JournalRound, ScenarioDocument, VehicleProfile
from fleet_bus.messages.journal import Call, Reference, digests, tube_digest
from fleet_bus.pubsub import Received
from fleet_bus.rejections import Rejections
from reach_server.data.events import EngineEvent
from reach_server.service import checkpoint, tube_messages
from reach_server.service.fleet import Fleet
from reach_server.service.ingest import decoded
from reach_server.service.journal import failure


class Sample(NamedTuple):
    """A sample that was taken in, and when it came (Unix ns)."""

    vehicle: str
    reference: Reference
    arrived: int


class MadeTube(NamedTuple):
    """A tube that was made: its vehicle, the sample that it starts from, and its digest."""

    vehicle: str
    epoch: int
    seq: int
    digest: bytes


@dataclass(frozen=True, slots=True)
class Round:
    """A round of a journal: all of its parts together."""

    head: JournalRound
    calls: tuple[Call, ...]
    samples: tuple[Sample, ...]
    tubes: tuple[MadeTube, ...]
    events: tuple[bytes, ...]
    chain: str

    @classmethod
    def of(cls, parts: Sequence[JournalRound]) -> "Round":
        """The round that some messages, in order, are all parts of."""
        calls: list[Call] = []
        samples: list[Sample] = []
        tubes: list[MadeTube] = []
        events: list[bytes] = []
        for part in parts:
            calls += part.calls
            named = part.references
            found = named[len(named) - len(part.arrived) :]
            vehicles = [part.vehicles[place] for place in part.sample_vehicle.tolist()]
            samples += map(Sample, vehicles, found, part.arrived.tolist())
            made = zip(
                part.tube_vehicle.tolist(), part.tube_epoch.tolist(), part.tube_seq.tolist(),
                digests(part.tube_digest), strict=True,
            )  # fmt: skip
            tubes += [MadeTube(part.vehicles[vehicle], epoch, seq, digest) for vehicle, epoch, seq, digest in made]
            events += digests(part.event_digest)
        return cls(parts[0], tuple(calls), tuple(samples), tuple(tubes), tuple(events), parts[-1].chain)

    @property
    def needed(self) -> list[Reference]:
        """The messages that the round took in."""
        documents = [reference(call) for call in self.calls if call.digest]
        return [*documents, *(sample.reference for sample in self.samples)]


@dataclass(slots=True)
class Made:
    """What a round leads to: tubes, events, and the error that ended it, if one did."""

    tubes: list[MadeTube] = field(default_factory=list)
    events: list[EngineEvent] = field(default_factory=list)
    failed: str = ""


class Replay:
    """A fleet that goes through the rounds of a server, from its start or from a checkpoint."""

    def __init__(self, server: str, server_epoch: int, parts: Sequence[CheckpointPart] = ()) -> None:
        """``parts`` are those of a checkpoint, in order; raises ``CheckpointError`` where it cannot be restored."""
        self._server = server
        self._server_epoch = server_epoch
        self._stamp = 1
        self._rejections = Rejections(interval=float("inf"))
        if parts:
            self._fleet = checkpoint.restored(parts, lambda: self._stamp)
        else:
            self._fleet = Fleet(self._rejections, lambda: self._stamp)

    def run(self, journaled: Round, find: Callable[[Reference], Received]) -> Made:
        """What a round leads to; ``find`` has the messages, all that are ``needed``."""
        made = Made()
        self._stamp = journaled.head.stamp
        for now in journaled.head.idle.tolist():
            self._do(made, partial(self._fleet.elapse, now))
        for call in journaled.calls:
            if call.kind == "process":
                self._process(made, journaled, find, call.now)
            elif call.kind == "elapse":
                self._do(made, partial(self._fleet.elapse, call.now))
            elif call.kind in ("hear", "gone", "let_go"):
                self._do(made, partial(self._note, call))
            else:
                self._do(made, partial(self._take, call, find(reference(call))))
        return made

    def _do(self, made: Made, work: Callable[[], list[EngineEvent]]) -> None:
        try:
            made.events += work()
        except MessageError:
            # The server refused it as well, or what comes of it differs.
            pass
        except Exception as error:
            made.failed = failure(error, inside=True)

    def _note(self, call: Call) -> list[EngineEvent]:
        if call.kind == "hear":
            self._fleet.hear_service(call.source, call.now)
        elif call.kind == "gone":
            self._fleet.mark_gone(call.subject)
        else:
            self._fleet.let_go(call.now)
        return []

    def _take(self, call: Call, item: Received) -> list[EngineEvent]:
        if call.kind == "profile":
            profile = VehicleProfile.decode(item.payload, item.encoding)
            return self._fleet.set_profile(keys.vehicle_of(item.key), profile, call.source, call.now)
        if call.kind == "document":
            document = ScenarioDocument.decode(item.payload, item.encoding)
            return self._fleet.set_scenario(document, call.source, call.now)
        return self._fleet.assign(Assignment.decode(item.payload, item.encoding), call.source, call.now)

    def _process(self, made: Made, journaled: Round, find: Callable[[Reference], Received], now: float) -> None:
        taken = [
            (sample.vehicle, replace(find(sample.reference), arrived_ns=sample.arrived)) for sample in journaled.samples
        ]
        inside = True
        try:
            batches = decoded(taken, self._rejections)
            if not batches:
                return
            outcome = self._fleet.process(batches, now)
            inside = False
            made.events += outcome.events
            for tube in tube_messages.of_round(
                outcome.tubes, journaled.head.note or None,
                server=self._server, server_epoch=self._server_epoch, compute_seconds=0.0,
            ):  # fmt: skip
                made.tubes.append(MadeTube(tube.vehicle, tube.epoch, tube.seq, tube_digest(tube.encode())))
        except Exception as error:
            made.failed = failure(error, inside=inside)


def reference(call: Call) -> Reference:
    """The message that a call took in."""
    return Reference(call.subject, call.source, bytes.fromhex(call.digest))
