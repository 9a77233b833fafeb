"""How often one vehicle may be told of: what happens with every sample a few times, and then how often it was."""

from dataclasses import dataclass, field, replace
from typing import Final

from fleet_bus.messages import EventKind
from reach_server.data.events import EngineEvent

#: Events of one kind about one vehicle that are published within a period (s).
MOST: Final = 5
PERIOD: Final = 10.0


@dataclass(slots=True)
class _Told:
    since: float
    number: int = 0
    withheld: int = 0


@dataclass(slots=True)
class EventLimit:
    """Holds back what goes beyond ``MOST`` events of a kind about a vehicle in ``PERIOD`` seconds, and counts it."""

    withheld: int = 0
    _told: dict[tuple[str, EventKind], _Told] = field(default_factory=dict)

    def admit(self, event: EngineEvent, now: float) -> EngineEvent | None:
        """The event as it is to be published at ``now`` (s), with how many were held back before it; or None."""
        key = event.vehicle, event.kind
        told = self._told.get(key)
        if told is None or now - told.since > PERIOD:
            before = 0 if told is None else told.withheld
            self._told[key] = _Told(now, 1)
            return replace(event, message=f"{event.message} (and {before} more before)") if before else event
        told.number += 1
        if told.number <= MOST:
            return event
        told.withheld += 1
        self.withheld += 1
        return None

    def forget(self, vehicle: str) -> None:
        """A vehicle is not known any more."""
        self._told = {key: told for key, told in self._told.items() if key[0] != vehicle}
