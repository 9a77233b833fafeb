"""Which scenario acts on which vehicle: what is in force, applied to the engines."""

from collections.abc import Iterable

import structlog

from fleet_bus.errors import ScenarioError
from fleet_bus.messages import Assignment, EventKind, ScenarioDocument
from reach_server.data.events import EngineEvent
from reach_server.service import fleet_events
from reach_server.service.registry import VehicleRegistry
from reach_server.service.scenario_book import ScenarioBook
from side_info import Scenario

_log = structlog.get_logger(__name__)


class ScenarioAssignments:
    """Scenarios, and who takes part in them; an assignment acts as soon as its scenario and its vehicle are there."""

    def __init__(self, registry: VehicleRegistry) -> None:
        self._registry = registry
        self._book = ScenarioBook()

    def put_document(self, document: ScenarioDocument, source: str, now: float) -> list[EngineEvent]:
        """Take over a scenario; raise ``MessageError`` if its document is not to be taken."""
        scenario = self._book.put_document(document, source, now)
        return [] if scenario is None else self._apply_all(self._book.of_scenario(scenario.name))

    def put_assignment(self, assignment: Assignment, source: str, now: float) -> list[EngineEvent]:
        """Take over an assignment; raise ``MessageError`` for one that is not to be taken."""
        self._book.put_assignment(assignment, source, now)
        return self._apply(assignment)

    def hear(self, source: str, now: float) -> None:
        """A side-info service was heard."""
        self._book.hear(source, now)

    def source(self, scenario: str) -> str:
        """Session of the service that publishes a scenario, empty where nobody does."""
        return self._book.source(scenario)

    def apply_to(self, vehicle: str) -> list[EngineEvent]:
        """Let all that is in force for a vehicle act on it, as after a change of its profile, class or clock."""
        return self._apply_all(self._book.of_vehicle(vehicle))

    def forget(self, vehicle: str) -> None:
        """A vehicle is not known any more."""
        self._book.forget(vehicle)

    def elapse(self, now: float) -> list[EngineEvent]:
        """What comes into force because time has passed, and which scenarios two services publish."""
        events: list[EngineEvent] = []
        for followed in self._book.elapse(now):
            others = () if followed.scenario is None else self._book.of_scenario(followed.scenario.name)
            events += self._apply_all({(a.scenario, a.vehicle): a for a in (*others, *followed.assignments)}.values())
        for contest in self._book.contested():
            events += [
                fleet_events.contested_scenario(assignment.vehicle, self._registry.stamp, contest)
                for assignment in self._book.of_scenario(contest.scenario)
                if assignment.vehicle in self._registry.vehicles
            ]
        return events

    def _apply_all(self, assignments: Iterable[Assignment]) -> list[EngineEvent]:
        return [event for assignment in list(assignments) for event in self._apply(assignment)]

    def _apply(self, assignment: Assignment) -> list[EngineEvent]:
        """Let an assignment act on its vehicle; what is wrong with it is told, and stops nobody else's."""
        known = self._registry.vehicles.get(assignment.vehicle)
        scenario = self._book.scenario(assignment.scenario)
        if known is None or known.profile is None or scenario is None:
            return []
        try:
            if known.engine is None:
                scenario.state_indices(known.profile)
            elif not assignment.active or self._suspended(assignment.vehicle, scenario):
                known.engine.unassign(assignment.vehicle, scenario.name)
            else:
                known.engine.assign(assignment.vehicle, scenario, assignment.time_zero, assignment.clock_offset)
        except Exception as error:
            # What was in force before is withdrawn: a scenario that cannot be followed must not cut.
            if known.engine is not None:
                known.engine.unassign(assignment.vehicle, scenario.name)
            if not isinstance(error, ScenarioError):
                _log.exception("an assignment failed", vehicle=assignment.vehicle, scenario=scenario.name)
            message = str(error) if isinstance(error, ScenarioError) else f"{type(error).__name__}: {error}"
            return [EngineEvent(EventKind.SCENARIO_REFUSED, assignment.vehicle, assignment.time_zero, message)]
        return []

    def _suspended(self, vehicle: str, scenario: Scenario) -> bool:
        """Whether a scenario speaks about a time of day that the vehicle's clock does not tell."""
        return scenario.time_zero is not None and vehicle in self._registry.clocks_off
