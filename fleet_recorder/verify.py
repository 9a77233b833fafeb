"""Whether a recording gives the same tubes again: the server's rounds computed anew, and compared to the last bit.

From the start of a server or from a checkpoint on, each round is run with the messages that the journal names, in the
order and at the times that it has; what comes out must be what the journal says came out. The first difference, or the
first message that is missing or altered, ends what is claimed; it goes on at the next checkpoint, or with the next
start of the server.
"""

from collections.abc import Iterable
from typing import Final

from fleet_bus.errors import MessageError
from fleet_bus.messages import StateSample
from fleet_bus.messages.journal import BEGINNING, Reference, link
from fleet_bus.pubsub import Received
from fleet_recorder.recorded import Name, Recorded, ServerRecord
from fleet_recorder.verify_report import Finding, Report, Stretch
from reach_server.service.build import build
from reach_server.service.journal import IN_FLEET, event_digest
from reach_server.service.object_graph import CheckpointError
from reach_server.service.replay import Made, MadeTube, Replay, Round

#: Findings of recorded tubes that are listed.
MOST_FINDINGS: Final = 20


def verify(messages: Iterable[Received]) -> Report:
    """Compute the rounds of all servers in a recording anew; ``messages`` may come in any order.

    All that vehicles and side-info services sent is held in memory, and one digest of each tube.
    """
    recorded = Recorded(messages)
    report = Report()
    named: dict[Name, set[bytes]] = {}
    for (server, epoch), record in sorted(recorded.servers.items(), key=lambda item: item[0][::-1]):
        if record.rounds:
            _Server(server, epoch, record, recorded, report, named).verify()
    _compare_recorded(recorded, report, named)
    if not any(record.rounds for record in recorded.servers.values()):
        report.notes.append(
            "no journal of a reach server is in the recording: there was none, or no token of a recorder"
        )
    for what, times in list(recorded.unreadable.items())[:MOST_FINDINGS]:
        report.notes.append(f"not read, {times} times: {what}")
    return report


class _Server:
    """The rounds of one server since one start."""

    def __init__(
        self,
        server: str,
        epoch: int,
        record: ServerRecord,
        recorded: Recorded,
        report: Report,
        named: dict[Name, set[bytes]],
    ) -> None:
        self._server = server
        self._epoch = epoch
        self._record = record
        self._recorded = recorded
        self._report = report
        self._named = named
        self._stretch: Stretch | None = None
        self._replay: Replay | None = None
        self._chain = BEGINNING

    def verify(self) -> None:
        """Go through the rounds that were recorded."""
        written = {part.build for parts in self._record.rounds.values() for _, part in parts.values()}
        if written != {build()}:
            self._report.notes.append(
                f"server {self._server} ran another build ({', '.join(sorted(written))}) than this one ({build()}): "
                "what differs may come from that"
            )
        for number in sorted(self._record.rounds):
            if self._stretch is not None and number != self._stretch.last + 1:
                lost = f"rounds {self._stretch.last + 1} to {number - 1} of the journal are not in the recording"
                self._end(Finding("gap", self._stretch.last + 1, lost))
            if self._replay is None:
                self._begin(number)
            if self._replay is None or self._stretch is None:
                self._report.unclaimed += 1
                continue
            finding = self._round(number, self._replay, self._stretch)
            if finding is None:
                self._stretch.last = number
            else:
                self._report.unclaimed += 1
                self._end(finding)

    def _begin(self, number: int) -> None:
        """Begin a stretch with a round, if it is the first one or follows a checkpoint."""
        if number == 1:
            self._replay, self._chain = Replay(self._server, self._epoch), BEGINNING
        elif parts := self._record.checkpoint(number - 1):
            try:
                self._replay, self._chain = Replay(self._server, self._epoch, parts), parts[0].chain
            except CheckpointError as error:
                self._report.findings.append(Finding("checkpoint", number - 1, str(error)))
                return
        else:
            return
        begins = "its start" if number == 1 else f"the checkpoint after round {number - 1}"
        self._stretch = Stretch(self._server, self._epoch, number, begins, last=number - 1)
        self._report.stretches.append(self._stretch)

    def _end(self, finding: Finding) -> None:
        if self._stretch is not None:
            self._stretch.finding = finding
        self._stretch = self._replay = None

    def _round(self, number: int, replay: Replay, stretch: Stretch) -> Finding | None:
        """Compute a round anew; what is first not as the server had it."""
        parts = self._record.rounds[number]
        of = next(iter(parts.values()))[1].part[1]
        if sorted(parts) != list(range(1, of + 1)):
            return Finding("gap", number, f"{len(parts)} of the {of} parts of the round are in the recording")
        for place in sorted(parts):
            payload, part = parts[place]
            self._chain = link(self._chain, payload)
            told = self._record.told.get(number, part.chain) if place == of else part.chain
            if not part.chain == self._chain == told:
                return Finding("chain", number, "the journal is not what the server wrote: its chain is broken")
        journaled = Round.of([parts[place][1] for place in sorted(parts)])
        finding = self._absent(number, journaled)
        if finding is None:
            finding = _difference(number, journaled, replay.run(journaled, self._recorded.inputs.__getitem__))
        if finding is None:
            stretch.rounds += 1
            stretch.samples += len(journaled.samples)
            stretch.tubes += len(journaled.tubes)
            stretch.events += len(journaled.events)
            for tube in journaled.tubes:
                self._named.setdefault(tube[:3], set()).add(tube.digest)
        return finding

    def _absent(self, number: int, journaled: Round) -> Finding | None:
        """The first message that the round took in and the recording has not."""
        absent = [reference for reference in journaled.needed if reference not in self._recorded.inputs]
        if not absent:
            return None
        wanted = absent[0]
        more = f", and {len(absent) - 1} more of this round" if len(absent) > 1 else ""
        named = f"of {wanted.key} from session {wanted.source[:8]}, digest {wanted.digest.hex()}"
        vehicle, epoch, seq, _ = self._first_tube(number, wanted) or MadeTube("", 0, 0, b"")
        if (other := self._in_place_of(wanted)) is not None:
            what = f"a message {named}, which the server took in, was altered: in its place is {_told(other)}{more}"
            return Finding("altered", number, what, vehicle, epoch, seq, wanted.key)
        what = f"a message {named}, which the server took in, is not in the recording{more}"
        return Finding("missing", number, what, vehicle, epoch, seq, wanted.key)

    def _in_place_of(self, wanted: Reference) -> Received | None:
        """A message that no server took in, and that stands where one that is wanted should."""
        inputs, taken = self._recorded.inputs, self._recorded.taken(wanted)
        same = [(reference, message) for reference, message in inputs.items() if reference[:2] == wanted[:2]]
        known = set(taken)
        others = [message for reference, message in same if reference not in known]
        place = taken.index(wanted)
        before = next((inputs[r] for r in taken[place::-1] if r in inputs), None)
        after = next((inputs[r] for r in taken[place:] if r in inputs), None)
        return next((message for message in others if _between(before, message, after)), None)

    def _first_tube(self, number: int, wanted: Reference) -> MadeTube | None:
        """The first tube, from a round on, of the vehicle whose message it is."""
        vehicle = wanted.key.rpartition("/")[0].rpartition("/")[2] if wanted.key.startswith("fleet/") else None
        for later in range(number, max(self._record.rounds) + 1):
            parts = self._record.rounds.get(later, {})
            for tube in Round.of([parts[place][1] for place in sorted(parts)]).tubes if parts else ():
                if vehicle is None or tube.vehicle == vehicle:
                    return tube
        return None


def _between(before: Received | None, message: Received, after: Received | None) -> bool:
    """Whether a message came between two others of its source, or is a sample between theirs by its number."""
    numbers = [_number(one) for one in (before, message, after)]
    if None not in numbers and numbers[0] < numbers[1] < numbers[2]:  # type: ignore[operator]
        return True
    return (before is None or before.arrived_ns <= message.arrived_ns) and (
        after is None or message.arrived_ns <= after.arrived_ns
    )


def _number(message: Received | None) -> tuple[int, int] | None:
    """Epoch and seq of a sample, if it is one that can be read."""
    try:
        sample = None if message is None else StateSample.decode(message.payload, message.encoding)
    except MessageError:
        return None
    return None if sample is None else (sample.epoch, sample.seq)


def _told(message: Received) -> str:
    """A message that is not what it was, in words."""
    if not message.key.endswith("/state"):
        return "another document"
    try:
        sample = StateSample.decode(message.payload, message.encoding)
    except MessageError as error:
        return f"one that cannot be read ({error.reason})"
    return f"a sample (epoch {sample.epoch}, seq {sample.seq}) of another content"


def _difference(number: int, journaled: Round, made: Made) -> Finding | None:
    """Where what a round leads to is first not what the server had."""
    was_failed = journaled.head.failed
    if made.failed != was_failed and (made.failed or was_failed.startswith(IN_FLEET)):
        ends = f"ended with {was_failed or 'no error'} at the server, with {made.failed or 'no error'} here"
        return Finding("failure", number, ends)
    # A round that the bus ended may have put fewer than it made.
    here = made.tubes[: len(journaled.tubes)] if was_failed else made.tubes
    for was, now in zip(journaled.tubes, here, strict=False):
        if was != now:
            other = "" if was[:3] == now[:3] else f", here {now.vehicle} (epoch {now.epoch}, seq {now.seq}) comes first"
            return Finding("tube", number, f"the tube is another one{other}", *was[:3])
    if len(here) != len(journaled.tubes):
        counts = f"{len(journaled.tubes)} tubes at the server, {len(here)} here"
        longer = journaled.tubes if len(journaled.tubes) > len(here) else tuple(here)
        first = longer[min(len(here), len(journaled.tubes))]
        return Finding("tube", number, counts, *first[:3])
    if list(journaled.events) != [event_digest(event) for event in made.events] and not was_failed:
        place = next(
            (
                k
                for k, (was, now) in enumerate(zip(journaled.events, made.events, strict=False))
                if was != event_digest(now)
            ),
            min(len(journaled.events), len(made.events)),
        )
        event = made.events[place] if place < len(made.events) else None
        here_is = (
            "none is told here" if event is None else f"here it is {event.kind} of {event.vehicle}: {event.message}"
        )
        return Finding("event", number, f"event {place + 1} of {len(journaled.events)} differs, {here_is}")
    return None


def _compare_recorded(recorded: Recorded, report: Report, named: dict[Name, set[bytes]]) -> None:
    """Hold the tubes of the recording against those that were computed anew."""
    known = set[bytes]().union(*named.values())
    report.recorded = sum(digest in known for digest in recorded.tubes)
    whole = {name for digest, name in recorded.tubes.items() if digest in known}
    for digest, name in recorded.tubes.items():
        if digest not in known and name in named and name not in whole and len(report.findings) < MOST_FINDINGS:
            report.findings.append(Finding("recorded", 0, "a recorded tube is not the one that the server put", *name))
    if lost := len(named.keys() - whole):
        report.notes.append(
            f"{lost} tubes that were computed anew are not in the recording: they were lost on their way to it"
        )
