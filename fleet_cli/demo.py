"""The whole loop on one machine: router, side information, reach server and simulated vehicles, and a viewer."""

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table

from fleet_bus.errors import FleetError, UsageError
from fleet_bus.messages import EventKind
from fleet_bus.router import Router
from fleet_cli.demo_page import start_page
from fleet_cli.monitor import Monitor, VehicleCoverage
from fleet_cli.processes import Children
from reach_server.side_information import first_contradiction
from side_info.documents.scenario import Scenario

#: Seconds that the processes have to get ready, and the vehicles to get their first tube.
READY_SECONDS = 60.0
#: Vehicles that one agent process serves.
VEHICLES_A_PROCESS = 50
#: Scenarios of the demo with the routes that obey them, and one that does not.
ROUTES = {
    "convoy": ("convoy", "parking-lot"),
    "intersection": ("intersection", "parking-lot"),
    "parking-lot": ("parking-lot", "roundabout"),
    "parking-lot-motion": ("parking-lot", "roundabout"),
    "roundabout": ("roundabout", "parking-lot"),
}
#: Events that an honest demo does not lead to.
UNWANTED = (
    EventKind.CONTRADICTION,
    EventKind.MISS,
    EventKind.DATA_CONTRADICTED,
    EventKind.PROFILE_REFUSED,
    EventKind.PROFILE_CONTRADICTED,
    EventKind.SCENARIO_REFUSED,
)


class Demo:
    """One run of the demo; ``run`` returns its summary, ``draw`` pictures it afterwards.

    The last ``stray`` of the vehicles take another route, which leaves the scenario. With a ``page_port`` the page is
    served meanwhile, on that port or the next one that is free.
    """

    def __init__(
        self,
        scenario: str,
        vehicles: int,
        duration: float,
        *,
        stray: int = 0,
        port: int = 0,
        seed: int = 1,
        page_port: int | None = None,
    ) -> None:
        if scenario not in ROUTES:
            raise UsageError(f"--scenario {scenario!r}: choose one of {', '.join(ROUTES)}")
        if stray > vehicles:
            raise UsageError(f"--stray {stray}: there are {vehicles} vehicles only")
        self.scenario = Scenario.load(scenario)
        self._routes = ROUTES[scenario]
        self._vehicles = [f"svea{i + 1}" for i in range(vehicles)]
        self._stray = self._vehicles[vehicles - stray :]
        self._duration = duration
        self._port = port
        self._page_port = page_port
        self._seed = seed
        # A scenario longer than the demo is played faster, so that all of it is seen.
        self._speed = max(1.0, self.scenario.end_ns / 1e9 / duration)
        self._monitor: Monitor | None = None

    def run(self, stop: threading.Event, *, live: bool, quiet: bool) -> dict[str, Any]:
        """Bring everything up, watch for the duration, end everything; the summary as a JSON document."""
        console = Console(quiet=quiet)
        with Router([f"tcp/127.0.0.1:{self._port}"]) as router, Children() as children, Children() as page:
            endpoint = router.endpoints[0]
            say = console.print
            say(f"router on {endpoint}", highlight=False)
            if self._page_port is not None:
                say(start_page(page, endpoint, self._page_port, stop), highlight=False, markup=False, soft_wrap=True)
            with Monitor([endpoint]) as monitor:
                self._monitor = monitor
                self._start(children, endpoint, stop, say)
                self._watch(monitor, children, stop, console, live=live)
                monitor.take_in()
        return self._summary(monitor)

    def _start(self, children: Children, endpoint: str, stop: threading.Event, say: Any) -> None:
        at = ("--router", endpoint)
        reach = children.start("reach server", "reach", "--id", "reach-1", *at)
        side_info = children.start("side-info", "side-info", self.scenario.name, *at)
        reach.wait_for("ready", READY_SECONDS, stop)
        side_info.wait_for("publishes", READY_SECONDS, stop)
        say(f"reach server and side information are up: scenario {self.scenario.name}", highlight=False)
        obedient = self._vehicles[: len(self._vehicles) - len(self._stray)]
        for route, chosen in zip(self._routes, (obedient, self._stray), strict=True):
            for first in range(0, len(chosen), VEHICLES_A_PROCESS):
                names = chosen[first : first + VEHICLES_A_PROCESS]
                seed = self._seed + self._vehicles.index(names[0])
                agents = children.start(
                    "vehicle agents", "agent", *(part for name in names for part in ("--vehicle", name)),
                    "--source", "sim", "--route", route, "--seed", str(seed), "--speed", str(self._speed), *at,
                )  # fmt: skip
                agents.wait_for("agents ready", READY_SECONDS, stop)
        pace = "" if self._speed == 1.0 else f", {self._speed:.3g} times faster than real time"
        say(f"{len(self._vehicles)} simulated vehicles drive{pace}", highlight=False)

    def _watch(
        self, monitor: Monitor, children: Children, stop: threading.Event, console: Console, *, live: bool
    ) -> None:
        deadline = time.monotonic() + READY_SECONDS
        while len(monitor.newest) < len(self._vehicles):
            monitor.take_in()
            if stop.wait(0.05):
                return
            self._check(children)
            if time.monotonic() > deadline:
                missing = sorted(set(self._vehicles) - set(monitor.newest))
                raise FleetError(f"no tube of {', '.join(missing)} within {READY_SECONDS:g} s: run again with fleet -v")
        end = time.monotonic() + self._duration
        next_line = 0.0
        with Live(console=console, auto_refresh=False, transient=True) as display:
            while (now := time.monotonic()) < end and not stop.wait(0.1):
                monitor.take_in()
                self._check(children)
                if live and console.is_terminal:
                    display.update(self._table(monitor), refresh=True)
                elif now >= next_line:
                    next_line = now + 2.0
                    for line in self._lines(monitor):
                        console.print(line, highlight=False, soft_wrap=True)

    def _check(self, children: Children) -> None:
        dead = children.dead()
        if dead is not None:
            raise FleetError(f"{dead.name} ended with exit code {dead.process.returncode}: {dead.errors()}")

    def _elapsed(self, monitor: Monitor, vehicle: str) -> float | None:
        assignment, tube = monitor.assignments.get(vehicle), monitor.newest.get(vehicle)
        return None if assignment is None or tube is None else (tube.t - assignment.time_zero) / 1e9

    def _lines(self, monitor: Monitor) -> list[str]:
        lines = []
        for vehicle, tube in sorted(monitor.newest.items()):
            low = tube.center[:, tube.position] + tube.hull[:, 0, tube.position]
            high = tube.center[:, tube.position] + tube.hull[:, 1, tube.position]
            elapsed = self._elapsed(monitor, vehicle)
            when = "      " if elapsed is None else f"{elapsed:5.1f}s"
            cuts = ", ".join(sorted({cut.predicate for cut in tube.cuts})) or "–"
            parts = [
                f"in {(tube.times[k] - tube.t) / 1e6:.0f} ms: x {low[k][0]:.2f}…{high[k][0]:.2f} "
                f"y {low[k][1]:.2f}…{high[k][1]:.2f}"
                for k in (0, len(tube.times) - 1)
            ]
            lines.append(f"{when} {vehicle:8} {tube.label:12} {'   '.join(parts)}   cut by {cuts}")
        return lines

    def _table(self, monitor: Monitor) -> Table:
        table = Table(title=f"{self.scenario.name}: where each vehicle can be next")
        for column in (
            "vehicle",
            "t",
            "label",
            "next x",
            "next y",
            "last x",
            "last y",
            "area m²",
            "uncut m²",
            "cut by",
        ):
            table.add_column(column)
        for vehicle, tube in sorted(monitor.newest.items()):
            low = tube.center[:, tube.position] + tube.hull[:, 0, tube.position]
            high = tube.center[:, tube.position] + tube.hull[:, 1, tube.position]
            elapsed = self._elapsed(monitor, vehicle)
            ranges = [f"{low[k][i]:6.2f} … {high[k][i]:5.2f}" for k in (0, -1) for i in (0, 1)]
            table.add_row(
                vehicle, "" if elapsed is None else f"{elapsed:.1f} s", str(tube.label), *ranges,
                f"{tube.area[-1]:.3f}", f"{tube.area_free[-1]:.3f}",
                ", ".join(sorted({cut.predicate for cut in tube.cuts})),
            )  # fmt: skip
        return table

    def _summary(self, monitor: Monitor) -> dict[str, Any]:
        seen = monitor.coverage()
        coverage = {vehicle: own for vehicle, own in seen.items() if vehicle not in self._stray}
        by_vehicle = {}
        for vehicle in self._vehicles:
            own = seen.get(vehicle)
            by_vehicle[vehicle] = {
                "samples": monitor.counts[vehicle]["samples"],
                "tubes": monitor.counts[vehicle]["tubes"],
                "checked": 0 if own is None else int(own.checked[:, 0].sum()),
                "inside": 0 if own is None else int(own.inside[:, 0].sum()),
                "label": str(monitor.newest[vehicle].label) if vehicle in monitor.newest else "none",
                "stray": vehicle in self._stray,
            }
        steps = _steps(list(coverage.values()))
        latency = monitor.latencies() * 1e3
        events: dict[str, int] = {}
        for event in monitor.events:
            if event.vehicle in self._stray and event.kind is EventKind.CONTRADICTION:
                continue
            # Played faster, stamps run ahead of the clock.
            if event.kind is EventKind.CLOCK and self._speed > 1.0:
                continue
            events[str(event.kind)] = events.get(str(event.kind), 0) + 1
        refused = dict(monitor.rejections.snapshot())
        for status in monitor.status.values():
            for reason, count in status.refused.items():
                refused[reason] = refused.get(reason, 0) + count
        summary: dict[str, Any] = {
            "scenario": self.scenario.name,
            "vehicles": len(self._vehicles),
            "duration": self._duration,
            "speed": self._speed,
            "samples": sum(v["samples"] for v in by_vehicle.values()),
            "tubes": sum(v["tubes"] for v in by_vehicle.values()),
            "by_vehicle": by_vehicle,
            "one_step": {key: steps[0][key] for key in ("checked", "inside")} if steps else {"checked": 0, "inside": 0},
            "horizon": {key: sum(step[key] for step in steps) for key in ("checked", "inside")},
            "area": _areas(steps),
            "latency_ms": {
                "p50": float(np.quantile(latency, 0.5)) if len(latency) else 0.0,
                "p99": float(np.quantile(latency, 0.99)) if len(latency) else 0.0,
            },
            "events": events,
            "refused": refused,
            "stray": {vehicle: self._strayed(monitor, vehicle) for vehicle in self._stray},
            "server_failures": sum(s.counters.get("failures", 0) for s in monitor.status.values()),
            "evaluation": self._evaluation(monitor, steps),
        }
        summary["failures"] = self._failures(summary)
        return summary

    def _strayed(self, monitor: Monitor, vehicle: str) -> dict[str, Any]:
        """When a vehicle left the scenario and when that was told (None: never), by which predicates, and how its sets
        held from then on."""
        told = [e for e in monitor.events if e.vehicle == vehicle and e.kind is EventKind.CONTRADICTION]
        left = self._left_at(monitor, vehicle)
        if not told:
            return {"left_at": left, "told_at": None, "predicates": "", "checked": 0, "inside": 0}
        own = monitor.coverage_from(vehicle, told[0].t)
        return {
            "left_at": left,
            "told_at": told[0].details["elapsed"],
            "predicates": told[0].details["predicate"],
            "checked": int(own.checked.sum()),
            "inside": int((own.inside & own.checked).sum()),
        }

    def _left_at(self, monitor: Monitor, vehicle: str) -> float | None:
        """Seconds after which the true states left the scenario no way to be true; None if they did not."""
        truths = [truth for key, truth in sorted(monitor.truths.items()) if key[0] == vehicle]
        zero = monitor.assignments[vehicle].time_zero
        truths = [truth for truth in truths if truth.t >= zero]
        if not truths:
            return None
        t, x = np.array([truth.t for truth in truths]), np.array([truth.x for truth in truths])
        return first_contradiction(self.scenario, monitor.profiles[vehicle], t, x, zero)

    def _evaluation(self, monitor: Monitor, steps: list[dict[str, Any]]) -> dict[str, Any]:
        labels: dict[str, int] = {}
        for seen in monitor.tubes.values():
            labels[str(seen.message.label)] = labels.get(str(seen.message.label), 0) + 1
        compute = [seen.message.compute_seconds * 1e6 for seen in monitor.tubes.values()]
        default = {
            "steps": [{key: value for key, value in step.items() if key != "area_free_mean"} for step in steps],
            "update_us_median": float(np.median(compute)) if compute else 0.0,
            "label_counts": labels,
        }
        return {"recordings": [], "profile": "svea", "horizon": len(steps), "methods": {"default": default}}

    def _failures(self, summary: dict[str, Any]) -> list[str]:
        failures = []
        for vehicle, own in summary["by_vehicle"].items():
            if own["tubes"] == 0:
                failures.append(f"no tube of {vehicle}")
            if own["inside"] < own["checked"] and vehicle not in self._stray:
                failures.append(f"{own['checked'] - own['inside']} true next states of {vehicle} lay outside their set")
        if summary["horizon"]["inside"] < summary["horizon"]["checked"]:
            failures.append("a true state lay outside its set within the horizon")
        if summary["one_step"]["checked"] == 0:
            failures.append("no prediction could be checked against the truth")
        for vehicle, own in summary["stray"].items():
            if own["told_at"] is None:
                failures.append(f"{vehicle} left the scenario, and no event told so")
            elif own["inside"] < own["checked"]:
                failures.append(f"a true state of {vehicle} lay outside its set after it had left the scenario")
        over_all = summary["area"].get("all")
        if over_all is not None and not over_all["with"] < over_all["without"]:
            failures.append("side information did not make the sets smaller")
        if summary["server_failures"]:
            failures.append(f"{summary['server_failures']} rounds of the reach server failed: run again with fleet -v")
        failures += [f"event {kind}: {count}" for kind, count in summary["events"].items() if kind in set(UNWANTED)]
        for step, area in summary["area"].items():
            if area["with"] > area["without"] * (1 + 1e-9):
                failures.append(f"side information made the sets of step {step} larger")
        return failures

    def draw(self, path: Path) -> None:
        """Draw the drive of the last run with tubes, cut and uncut; raise ``UsageError`` if that fails."""
        from fleet_cli.picture import draw_demo

        if self._monitor is None:
            raise UsageError("nothing has run yet")
        draw_demo(self._monitor, self.scenario, path)


def _areas(steps: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Mean areas with and without side information at the first step, the last, and over all."""
    if not steps:
        return {}
    areas = {str(s["step"]): {"with": s["area_mean"], "without": s["area_free_mean"]} for s in (steps[0], steps[-1])}
    areas["all"] = {
        "with": float(np.mean([s["area_mean"] for s in steps])),
        "without": float(np.mean([s["area_free_mean"] for s in steps])),
    }
    return areas


def _steps(coverage: list[VehicleCoverage]) -> list[dict[str, Any]]:
    """Figures by step over all vehicles."""
    if not coverage:
        return []
    checked, inside, area, free = (
        np.concatenate([getattr(c, name) for c in coverage]) for name in ("checked", "inside", "area", "area_free")
    )
    return [
        {
            "step": h + 1,
            "checked": int(checked[:, h].sum()),
            "inside": int((inside & checked)[:, h].sum()),
            "area_mean": float(area[:, h].mean()),
            "area_median": float(np.median(area[:, h])),
            "area_free_mean": float(free[:, h].mean()),
        }
        for h in range(checked.shape[1])
    ]
