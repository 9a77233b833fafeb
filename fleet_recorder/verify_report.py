"""What the verification of a recording found, for people and for programs."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Finding:
    """The first thing in a stretch that is not as the server had it.

    ``kind``: ``tube`` or ``event`` where what comes out differs, ``failure`` where the rounds end otherwise;
    ``altered`` or ``missing`` where a message that the server took in is not in the recording as it was; ``recorded``
    where a recorded tube is not what the server put; ``chain``, ``gap`` or ``checkpoint`` where the journal is broken.
    ``vehicle``, ``epoch`` and ``seq`` name the first tube that is concerned, where one is.
    """

    kind: str
    round: int
    what: str
    vehicle: str = ""
    epoch: int = 0
    seq: int = 0
    key: str = ""

    def __str__(self) -> str:
        tube = f", first tube concerned: {self.vehicle} (epoch {self.epoch}, seq {self.seq})" if self.vehicle else ""
        return f"round {self.round}: {self.what}{tube}"


@dataclass(slots=True)
class Stretch:
    """Rounds ``first`` to ``last`` of one server that were computed anew without a break, from its start or from a
    checkpoint; what was ``finding``, if anything, ended it, and nothing is claimed from there on."""

    server: str
    server_epoch: int
    first: int
    begins: str
    last: int = 0
    rounds: int = 0
    samples: int = 0
    tubes: int = 0
    events: int = 0
    finding: Finding | None = None


@dataclass(slots=True)
class Report:
    """The result of verifying a recording.

    ``recorded`` counts the tubes of the recording that are, byte for byte, those that were computed anew, but for the
    time that they took. ``unclaimed`` are rounds that nothing is said about: before the first checkpoint, or after a
    finding. ``notes`` say what else one should know.
    """

    stretches: list[Stretch] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    recorded: int = 0
    unclaimed: int = 0
    notes: list[str] = field(default_factory=list)

    @property
    def all_findings(self) -> list[Finding]:
        """All findings, those that ended a stretch first."""
        return [*(s.finding for s in self.stretches if s.finding is not None), *self.findings]

    def total(self, what: str) -> int:
        """Rounds, samples, tubes or events of all stretches together."""
        return sum(getattr(stretch, what) for stretch in self.stretches)

    @property
    def equal(self) -> bool:
        """Whether tubes were compared, and all was equal."""
        return self.total("tubes") > 0 and not self.all_findings

    def json(self) -> dict[str, Any]:
        """The report as a JSON document."""
        counts = {what: self.total(what) for what in ("rounds", "samples", "tubes", "events")}
        return {
            "equal": self.equal, **counts, "recorded": self.recorded, "unclaimed": self.unclaimed,
            "findings": [asdict(finding) for finding in self.all_findings],
            "stretches": [asdict(stretch) for stretch in self.stretches], "notes": self.notes,
        }  # fmt: skip

    def lines(self) -> Iterator[str]:
        """The report for people, line by line, the verdict first."""
        counts = ", ".join(f"{self.total(what)} {what}" for what in ("rounds", "samples", "tubes", "events"))
        if self.equal:
            yield f"equal: {counts} computed anew, all as the server had them; {self.recorded} tubes are recorded"
        elif self.all_findings:
            yield f"not equal: {counts} were equal, then"
        else:
            yield "nothing to verify: no tube could be computed anew"
        for finding in self.all_findings:
            yield f"  {finding}"
        for stretch in self.stretches:
            rounds = f"rounds {stretch.first} to {stretch.last}" if stretch.rounds else "no round"
            yield (
                f"server {stretch.server} started {stretch.server_epoch}: {rounds} from {stretch.begins}, "
                f"{stretch.samples} samples, {stretch.tubes} tubes"
            )
        if self.unclaimed:
            yield f"{self.unclaimed} rounds without a claim: before the first checkpoint, or after what was found"
        yield from self.notes
