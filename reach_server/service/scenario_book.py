"""Which scenarios and assignments are in force: from one writer each, of versions that only go up."""

from dataclasses import dataclass, field
from typing import Final

from fleet_bus.errors import MessageError, ScenarioError
from fleet_bus.messages import Assignment, ScenarioDocument
from fleet_bus.writers import Change, Source, Turn, Writer
from side_info import Scenario

#: Seconds after which a service that was not heard is gone; it publishes its status once a second.
SERVICE_GONE: Final = 3.5
#: What is kept at most; a fleet has a handful of scenarios.
MOST_SCENARIOS: Final = 1000
MOST_ASSIGNMENTS: Final = 100_000


@dataclass(slots=True)
class _Entry:
    """A scenario's writer, and what another one has sent that may follow it."""

    writer: Writer = field(default_factory=lambda: Writer(evidence=1))
    scenario: Scenario | None = None
    held_document: Scenario | None = None
    held_assignments: dict[str, Assignment] = field(default_factory=dict)

    def forget_held(self) -> None:
        self.held_document = None
        self.held_assignments.clear()


@dataclass(frozen=True, slots=True)
class Followed:
    """What is in force now that another service writes a scenario: its document, if it is newer, and assignments."""

    scenario: Scenario | None
    assignments: tuple[Assignment, ...]


@dataclass(frozen=True, slots=True)
class Contested:
    """A second service publishes a scenario while the first is there; both are named."""

    scenario: str
    first: Source
    second: Source


class ScenarioBook:
    """Scenarios by name and assignments by (scenario, vehicle), each scenario's from one side-info service.

    What another service sends is held until the first was not heard for ``SERVICE_GONE`` seconds. A version must be
    above the one in force, whoever sends it.
    """

    def __init__(self) -> None:
        self._entries: dict[str, _Entry] = {}
        self._assignments: dict[tuple[str, str], Assignment] = {}
        self._contested: list[Contested] = []
        self._followed: list[Followed] = []

    def scenario(self, name: str) -> Scenario | None:
        """The scenario of a name that is in force."""
        entry = self._entries.get(name)
        return None if entry is None else entry.scenario

    def source(self, name: str) -> str:
        """Session that writes a scenario, empty where none does."""
        entry = self._entries.get(name)
        return "" if entry is None or entry.writer.source is None else entry.writer.source.session

    def of_vehicle(self, vehicle: str) -> list[Assignment]:
        """Assignments of a vehicle."""
        return [a for a in self._assignments.values() if a.vehicle == vehicle]

    def of_scenario(self, name: str) -> list[Assignment]:
        """Assignments to a scenario."""
        return [a for a in self._assignments.values() if a.scenario == name]

    def put_document(self, document: ScenarioDocument, source: str, now: float) -> Scenario | None:
        """The scenario that is in force from now on, or None where nothing changes.

        Raises ``MessageError`` for a document that does not parse, is not what it says, is of an older version
        (``old_version``) or of another service than the one that publishes the scenario (``other_source``).
        """
        try:
            scenario = Scenario.parse(document.text, f"scenario {document.scenario}")
        except ScenarioError as error:
            raise MessageError("fields", str(error)) from None
        if (scenario.name, scenario.version) != (document.scenario, document.version):
            raise MessageError("fields", f"document {document.scenario} v{document.version} holds {scenario.name}")
        entry = self._entry(scenario.name)
        if self._judge(entry, scenario.name, source, now) is not Turn.ACCEPT:
            entry.held_document = scenario
            raise self._other(scenario.name, entry)
        return self._adopt(entry, scenario)

    def put_assignment(self, assignment: Assignment, source: str, now: float) -> None:
        """Take an assignment into force; raises ``MessageError`` (``other_source``, ``overflow``) where it is not."""
        entry = self._entry(assignment.scenario)
        key = assignment.scenario, assignment.vehicle
        if key not in self._assignments and len(self._assignments) >= MOST_ASSIGNMENTS:
            raise MessageError("overflow", f"{MOST_ASSIGNMENTS} assignments are in force already")
        if self._judge(entry, assignment.scenario, source, now) is not Turn.ACCEPT:
            if len(entry.held_assignments) < MOST_ASSIGNMENTS:
                entry.held_assignments[assignment.vehicle] = assignment
            raise self._other(assignment.scenario, entry)
        self._assignments[key] = assignment

    def hear(self, source: str, now: float) -> None:
        """A service was heard, by its status for instance: it is still there, as the writer or as the one to follow."""
        for name, entry in self._entries.items():
            if Source(source) in (entry.writer.source, entry.writer.rival):
                self._judge(entry, name, source, now)

    def elapse(self, now: float) -> list[Followed]:
        """What comes into force because a service that wrote it is gone."""
        for entry in self._entries.values():
            change = entry.writer.elapse(now, SERVICE_GONE, SERVICE_GONE)
            if change in (Change.TAKEN_OVER, Change.LOST):
                self._followed.append(self._follow(entry))
            elif change is not Change.NONE:
                entry.forget_held()
        followed, self._followed = self._followed, []
        return followed

    def contested(self) -> list[Contested]:
        """Scenarios that turned out to have two writers since the last call."""
        found, self._contested = self._contested, []
        return found

    def forget(self, vehicle: str) -> None:
        """Let go of the assignments of a vehicle that is not there any more and takes part in nothing."""
        for assignment in self.of_vehicle(vehicle):
            if not assignment.active:
                del self._assignments[assignment.scenario, vehicle]

    def _entry(self, name: str) -> _Entry:
        entry = self._entries.get(name)
        if entry is None:
            if len(self._entries) >= MOST_SCENARIOS:
                raise MessageError("overflow", f"{MOST_SCENARIOS} scenarios are in force already")
            entry = self._entries[name] = _Entry()
        return entry

    def _judge(self, entry: _Entry, name: str, source: str, now: float) -> Turn:
        before, rival = entry.writer.source, entry.writer.rival
        turn, change = entry.writer.judge(Source(source), 1, now, SERVICE_GONE, SERVICE_GONE)
        if change is Change.CONFLICT and before is not None and rival is not None:
            self._contested.append(Contested(name, before, rival))
        elif change in (Change.STAYED, Change.DISMISSED):
            entry.forget_held()
        elif change in (Change.TAKEN_OVER, Change.LOST):
            self._followed.append(self._follow(entry))
        return turn

    def _follow(self, entry: _Entry) -> Followed:
        scenario = entry.held_document
        try:
            adopted = None if scenario is None else self._adopt(entry, scenario)
        except MessageError:
            # Its document is older; what it assigns counts for the one in force.
            adopted = None
        assignments = tuple(entry.held_assignments.values())
        for assignment in assignments:
            self._assignments[assignment.scenario, assignment.vehicle] = assignment
        entry.forget_held()
        return Followed(adopted, assignments)

    def _adopt(self, entry: _Entry, scenario: Scenario) -> Scenario | None:
        known = entry.scenario
        if known is not None and known.text == scenario.text:
            # Published again: what was contradicted stays so.
            return None
        if known is not None and scenario.version <= known.version:
            raise MessageError(
                "old_version",
                f"scenario {scenario.name} v{scenario.version} came, v{known.version} is in force and stays: raise the "
                f"version to {known.version + 1}",
            )
        entry.scenario = scenario
        return scenario

    @staticmethod
    def _other(name: str, entry: _Entry) -> MessageError:
        return MessageError(
            "other_source",
            f"scenario {name} is published by {entry.writer.source}, {entry.writer.rival} publishes it too: stop one "
            f"of the two; the other one's counts when the first has been silent for {SERVICE_GONE:g} s",
        )
