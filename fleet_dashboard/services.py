"""Which services are there, and which of them have fallen silent."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from fleet_bus.messages import ServiceStatus
from fleet_dashboard.picture import SILENT_SECONDS

#: Services that are remembered.
MOST_SERVICES: Final = 200


@dataclass(slots=True)
class ServiceSeen:
    """What is known of one service: its newest status, when it last gave a sign of life (ns), and whether its
    liveliness token has gone since."""

    kind: str
    instance: str
    status: ServiceStatus | None = None
    sign: int = 0
    gone: bool = False

    def silent(self, t: int) -> bool:
        """Whether it is gone, or has been silent for too long, at ``t`` (ns)."""
        return self.gone or t - self.sign > SILENT_SECONDS * 1e9


@dataclass(slots=True)
class Services:
    """All services that were heard of, by kind and instance."""

    seen: dict[tuple[str, str], ServiceSeen] = field(default_factory=dict)

    def _of(self, kind: str, instance: str) -> ServiceSeen:
        if len(self.seen) >= MOST_SERVICES and (kind, instance) not in self.seen:
            self.seen.pop(min(self.seen, key=lambda key: self.seen[key].sign))
        return self.seen.setdefault((kind, instance), ServiceSeen(kind, instance))

    def status(self, status: ServiceStatus, arrived: int) -> None:
        """A status came at ``arrived`` (ns). One out of a cache, of a service whose token is gone, is no sign of
        life."""
        service = self._of(status.kind, status.instance)
        if service.status is None or status.t > service.status.t:
            service.status = status
            service.sign = max(service.sign, arrived)
            service.gone = False

    def token(self, key: str, alive: bool, now: int) -> None:
        """A liveliness token came or went."""
        parts = key.split("/")
        if len(parts) != 3 or parts[0] != "svc":
            return
        service = self._of(parts[1], parts[2])
        service.gone = not alive
        if alive:
            service.sign = max(service.sign, now)

    def heard(self, server: str, arrived: int) -> None:
        """A tube of a server came."""
        service = self._of("reach", server)
        service.sign = max(service.sign, arrived)

    def servers(self) -> list[ServiceSeen]:
        """All reach servers."""
        return [service for (kind, _), service in self.seen.items() if kind == "reach"]

    def silent_servers(self, t: int) -> list[str]:
        """Reach servers that are silent at ``t`` (ns)."""
        return [service.instance for service in self.servers() if service.silent(t)]

    def waiting(self) -> Mapping[str, str]:
        """Vehicles without a tube, and why, as servers that are not gone say."""
        found: dict[str, str] = {}
        for service in self.servers():
            if service.status is not None and not service.gone:
                found |= service.status.waiting
        return found

    def problems(self, t: int, asked: set[str]) -> list[str]:
        """Sentences about what is wrong: servers that fell silent although tubes shown are theirs (``asked``) or
        although none other is there, and what services say of themselves."""
        servers = self.servers()
        nobody = bool(servers) and all(service.silent(t) for service in servers)
        said = []
        for service in servers:
            if service.silent(t) and (service.instance in asked or nobody):
                silence = f"silent for {max(0.0, (t - service.sign) / 1e9):.0f} s"
                said.append(f"reach server {service.instance}: {'gone, ' if service.gone else ''}{silence}")
        for service in self.seen.values():
            if service.status is not None and not service.silent(t):
                said += [f"{service.kind} {service.instance}: {problem}" for problem in service.status.problems]
        return said
