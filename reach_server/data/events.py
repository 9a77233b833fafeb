"""What happened to a vehicle, before it becomes a message."""

from dataclasses import dataclass, field
from typing import Any

from fleet_bus.messages import EventKind

#: Characters of the message of an event, and of each text of its details; the rest is left out.
LONGEST_MESSAGE, LONGEST_DETAIL = 2000, 1000


@dataclass(frozen=True, slots=True)
class EngineEvent:
    """Something that happened to one vehicle in one step, at the sample of stamp ``t`` (ns); what ``details`` hold for
    each kind is on the page of the wire, under Event."""

    kind: EventKind
    vehicle: str
    t: int
    message: str
    details: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # A scenario may name more predicates than a message has room for.
        object.__setattr__(self, "message", self.message[:LONGEST_MESSAGE])
        short = {
            name: value[:LONGEST_DETAIL] if isinstance(value, str) else value for name, value in self.details.items()
        }
        object.__setattr__(self, "details", short)
