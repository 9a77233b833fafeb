"""Who runs the fleet: services with their newest status, and what the page itself refused."""

from typing import Any

from nicegui import ui

from fleet_dashboard.gateway import Gateway


class ServicesView:
    """A table of services, and lists of what waits, what was refused and what is not drawn."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        names = ("service", "sign of life", "state", "vehicles", "waiting", "compute ms", "failures")
        columns: list[dict[str, Any]] = [
            {"name": name, "label": name, "field": name, "align": "left"} for name in names
        ]
        self._table = ui.table(columns=columns, rows=[], row_key="service").props("dense flat").classes("w-full")
        self._notes = ui.column().classes("w-full gap-0 text-sm q-pa-sm")
        self._shown: list[str] | None = None

    def refresh(self) -> None:
        """Show what is known now."""
        gateway = self._gateway
        now = gateway.picture.t
        rows = []
        for (kind, instance), service in sorted(gateway.services.seen.items()):
            status = service.status
            gauges = {} if status is None else status.gauges
            rows.append(
                {
                    "service": f"{kind} {instance}",
                    "sign of life": f"{max(0.0, (now - service.sign) / 1e9):.0f} s ago" if service.sign else "never",
                    "state": "gone" if service.gone else "silent" if service.silent(now) else "there",
                    "vehicles": f"{gauges['vehicles']:.0f}" if "vehicles" in gauges else "",
                    "waiting": f"{gauges['waiting']:.0f}" if "waiting" in gauges else "",
                    "compute ms": f"{1e3 * gauges['compute_p50']:.2g}" if "compute_p50" in gauges else "",
                    "failures": "" if status is None else str(status.counters.get("failures", 0)),
                }
            )
        self._table.rows = rows
        self._tell(self._said())

    def _said(self) -> list[str]:
        gateway = self._gateway
        said = [f"{vehicle} waits: {why}" for vehicle, why in sorted(gateway.services.waiting().items())[:50]]
        said += [f"scenario {name}: {why}" for name, why in sorted(gateway.regions.problems().items())]
        for scenario, regions in sorted(gateway.regions.all().items()):
            said += [f"region {scenario}/{name} is not drawn: {why}" for name, why in sorted(regions.left_out.items())]
        said += [
            f"the page refused {count} messages: {reason}"
            for reason, count in sorted(gateway.rejections.snapshot().items())
        ]
        return said

    def _tell(self, said: list[str]) -> None:
        if said == self._shown:
            return
        self._shown = said
        self._notes.clear()
        with self._notes:
            for line in said:
                ui.label(line).classes("fleet-quiet break-words")
