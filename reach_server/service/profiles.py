"""Which profile of a vehicle is in force: that of the session that writes its states."""

from fleet_bus import keys
from fleet_bus.errors import MessageError
from fleet_bus.messages import EventKind, VehicleProfile
from fleet_bus.rejections import Rejections
from fleet_bus.writers import EVIDENCE, Source
from reach_server.data.events import EngineEvent
from reach_server.service import fleet_events
from reach_server.service.registry import VehicleRegistry
from reach_server.service.scenario_assignments import ScenarioAssignments
from reach_server.service.vehicle import Vehicle


class Profiles:
    """Takes profiles over, and keeps those of other sessions for the case that these come to write the states."""

    def __init__(self, registry: VehicleRegistry, scenarios: ScenarioAssignments, rejections: Rejections) -> None:
        self._registry = registry
        self._scenarios = scenarios
        self._rejections = rejections

    def put(self, vehicle: str, profile: VehicleProfile, source: str, now: float) -> list[EngineEvent]:
        """Take over a profile that a session sends at ``now`` (s), or keep it.

        Raises ``MessageError`` for one that no engine can work with, and where another session's is in force.
        """
        known = self._registry.known(vehicle)
        if known is None:
            raise MessageError("overflow", self._registry.full)
        known.seen, known.gone = now, False
        if known.profile != profile:
            self._registry.check_usable(profile)
        known.offer(source, profile)
        if known.writes(source):
            return self._adopt(vehicle, known, profile, source)
        if known.writer.there(now, known.leave):
            # An agent that follows another sends its profile first: whether this is one shows by who goes on.
            known.foreign = source, 0
        elif known.writer.source is None:
            raise MessageError("other_source", f"another session has published the profile of {vehicle}: it counts")
        return []

    def _adopt(self, vehicle: str, known: Vehicle, profile: VehicleProfile, source: str) -> list[EngineEvent]:
        """Put a profile that is usable in force."""
        before, known.profile_source, known.awaits_profile = known.profile, source, False
        if before == profile:
            return []
        known.profile, known.told, known.plan = profile, set(), None
        left, known.engine = known.engine, None
        if left is not None:
            self._registry.enter(vehicle, known, profile)
            self._registry.leave(vehicle, left)
        events = self._scenarios.apply_to(vehicle)
        if before is not None:
            events.append(fleet_events.profile_changed(vehicle, self._registry.stamp, before, profile))
        return events

    def begin(self, vehicle: str, known: Vehicle, source: Source) -> list[EngineEvent]:
        """The first source of a vehicle, or another one, writes its states: its profile counts from now on."""
        if known.profile is None or not source.session or source.session == known.profile_source:
            return []
        offered = known.offered.get(source.session)
        if offered is None:
            known.awaits_profile = True
            return []
        return self._adopt(vehicle, known, offered, source.session)

    def tell_foreign(self, vehicle: str, known: Vehicle, count: int, t: int, events: list[EngineEvent]) -> None:
        """Take in ``count`` samples of the writer, the last one's stamp ``t``: once they are evidence that the session
        whose profile came last is not about to write, its profile is refused, which is counted and told once."""
        session, since = known.foreign or ("", 0)
        if since + count < EVIDENCE:
            known.foreign = session, since + count
            return
        known.foreign = None
        detail = f"{Source(session)} publishes a profile of {vehicle}, whose states {known.writer.source} publishes"
        self._rejections.count(MessageError("other_source", detail), keys.profile(vehicle))
        if f"profile of {session}" not in known.told:
            known.told.add(f"profile of {session}")
            events.append(EngineEvent(EventKind.PROFILE_REFUSED, vehicle, t, f"profile refused: {detail}"))
