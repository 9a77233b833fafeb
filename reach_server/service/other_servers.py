"""Other reach servers on the bus, by their status: each of them publishes tubes of the same vehicles."""

from dataclasses import dataclass
from typing import Final

from fleet_bus.messages import ServiceStatus

#: Seconds after which a server whose status does not come any more is gone; it comes once a second.
GONE: Final = 3.5


@dataclass(slots=True)
class _Other:
    instance: str
    heard: float


class OtherServers:
    """Which other servers are there, by session; ``own`` is the session of this one, called ``instance``."""

    def __init__(self, own: str, instance: str) -> None:
        self._own = own
        self._instance = instance
        self._others: dict[str, _Other] = {}

    def hear(self, status: ServiceStatus, source: str, now: float) -> str | None:
        """Take in the status of a server, at ``now`` (s); what is to be told of one that was not there before."""
        if source == self._own:
            return None
        known = self._others.get(source)
        self._others[source] = _Other(status.instance, now)
        return None if known is not None else f"{self._describe(status.instance, source)} publishes tubes as well"

    def elapse(self, now: float) -> list[str]:
        """What is to be told of those that are gone."""
        gone = [source for source, other in self._others.items() if now - other.heard > GONE]
        return [f"{self._describe(self._others.pop(source).instance, source)} is gone" for source in gone]

    @property
    def problems(self) -> list[str]:
        """Who else is there now."""
        return [
            f"{self._describe(other.instance, source)} publishes tubes of the same vehicles: stop one of the two"
            for source, other in sorted(self._others.items())
        ]

    def _describe(self, instance: str, source: str) -> str:
        same = " of the same id" if instance == self._instance else ""
        return f"another reach server{same}, {instance} (session {source[:8]}),"
