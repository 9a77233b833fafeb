"""What happened: events, and what became of each obligation of a vehicle.

A thing happened at its own time, but not later than it was heard of: clocks of vehicles may be ahead, and a simulation
that is played fast is.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from fleet_bus.messages import Event, EventKind

MOST_EVENTS: Final = 2000
MOST_TRANSITIONS: Final = 20_000
#: What is followed at once: vehicles times obligations.
MOST_FOLLOWED: Final = 20_000

#: Kinds of events that mean that something is wrong, rather than that something is.
ALARMS: Final = frozenset(
    {
        EventKind.CONTRADICTION, EventKind.MISS, EventKind.DATA_CONTRADICTED, EventKind.PROFILE_REFUSED,
        EventKind.PROFILE_CONTRADICTED, EventKind.SCENARIO_REFUSED, EventKind.TWO_SOURCES, EventKind.SECOND_SERVER,
        EventKind.VEHICLE_GONE, EventKind.BEHIND,
    }
)  # fmt: skip


#: How the side information of a scenario ends among its obligations; requirements are called otherwise.
ASSUMED: Final = ".assume"


class Fate(StrEnum):
    """What has become of an obligation."""

    PENDING = "pending"
    WITNESSED = "witnessed"
    CONTRADICTED = "contradicted"


def fate(verdict: str) -> Fate:
    """What a verdict on the wire says; what a newer server may say beside it is pending."""
    word = verdict.partition(",")[0]
    return {"satisfied": Fate.WITNESSED, "violated": Fate.CONTRADICTED}.get(word, Fate.PENDING)


@dataclass(frozen=True, slots=True)
class Transition:
    """From ``t`` (ns) on an obligation of a vehicle has this fate; ``verdict`` is the text that said so."""

    t: int
    vehicle: str
    obligation: str
    fate: Fate
    verdict: str

    @property
    def words(self) -> str:
        """What a contradicted one means, for a person."""
        if self.obligation.endswith(ASSUMED):
            return f"left its scenario: {self.verdict}"
        return f"violates {self.obligation}"


class Obligations:
    """Requirements, and the side information itself (``<scenario>.assume``), of all vehicles through time."""

    def __init__(self) -> None:
        #: The newest transitions, by vehicle and obligation.
        self._of: dict[str, dict[str, Transition]] = {}
        self._followed = 0
        self.transitions: deque[Transition] = deque(maxlen=MOST_TRANSITIONS)

    def verdicts(self, vehicle: str, verdicts: Mapping[str, str], t: int) -> bool:
        """Verdicts that a tube carries, which was computed from a sample at ``t`` (ns); whether one is new."""
        told = [self._tell(vehicle, str(o), fate(str(v)), str(v), t) for o, v in verdicts.items()]
        return any(told)

    def assigned(self, vehicle: str, scenario: str, active: bool, t: int) -> None:
        """A vehicle takes part in a scenario from ``t`` (ns) on, or no longer. What is said again of a scenario that it
        has left since does not bring it back."""
        before = self._of.get(vehicle, {}).get(scenario + ASSUMED)
        if active and (before is None or before.t < t):
            self._tell(vehicle, scenario + ASSUMED, Fate.PENDING, "holds so far", t)

    def event(self, event: Event, arrived: int) -> None:
        """Of events, a contradiction ends the side information; it ``arrived`` at some time (ns)."""
        if event.kind is EventKind.CONTRADICTION and event.vehicle is not None:
            scenario = str(event.details.get("scenario", "scenario"))[:64]
            self._tell(event.vehicle, scenario + ASSUMED, Fate.CONTRADICTED, event.message, min(event.t, arrived))

    def _tell(self, vehicle: str, obligation: str, what: Fate, verdict: str, t: int) -> bool:
        before = self._of.get(vehicle, {}).get(obligation)
        if before is not None and before.fate is what:
            return False
        if before is None:
            if self._followed >= MOST_FOLLOWED:
                return False
            self._followed += 1
        known = self._of.setdefault(vehicle, {})
        known[obligation] = Transition(t, vehicle, obligation, what, verdict)
        self.transitions.append(known[obligation])
        return True

    def contradicted(self, vehicle: str, t: int) -> list[Transition]:
        """Obligations of a vehicle that are contradicted and were by ``t`` (ns), side information first."""
        known = self._of.get(vehicle, {}).values()
        found = [now for now in known if now.fate is Fate.CONTRADICTED and now.t <= t]
        return sorted(found, key=lambda now: not now.obligation.endswith(ASSUMED))

    def until(self, t: int) -> dict[tuple[str, str], list[Transition]]:
        """Transitions not after ``t`` (ns) by vehicle and obligation, in order."""
        found: dict[tuple[str, str], list[Transition]] = {}
        for transition in list(self.transitions):
            if transition.t <= t:
                found.setdefault((transition.vehicle, transition.obligation), []).append(transition)
        return found


class EventLog:
    """The newest events, each once: what is recovered comes twice."""

    def __init__(self) -> None:
        self._events: deque[tuple[int, Event]] = deque()
        self._known: set[tuple[str, str | None, str, int, str]] = set()
        #: Grows with each event.
        self.count = 0

    def add(self, event: Event, arrived: int) -> bool:
        """Keep an event that ``arrived`` at some time (ns); whether it is new."""
        key = self._key(event)
        if key in self._known:
            return False
        self._known.add(key)
        self._events.append((min(event.t, arrived), event))
        self.count += 1
        if len(self._events) > MOST_EVENTS:
            self._known.discard(self._key(self._events.popleft()[1]))
        return True

    @staticmethod
    def _key(event: Event) -> tuple[str, str | None, str, int, str]:
        return event.source, event.vehicle, str(event.kind), event.t, event.message

    def until(self, t: int, vehicle: str | None = None) -> list[tuple[int, Event]]:
        """When (ns) and what, not after ``t`` (ns), newest first, about one vehicle if it is named."""
        wanted = [(when, event) for when, event in list(self._events) if when <= t and vehicle in (None, event.vehicle)]
        return sorted(wanted, key=lambda found: -found[0])
