"""Which scenario cuts which vehicle, since when, and when a scenario turned out to be false."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Cut, EventKind, VehicleProfile
from reach_server.predicates import CutTable, activity, compile_cuts
from reach_server.results import EngineEvent
from reach_server.windows import Ints
from side_info import Scenario


@dataclass(slots=True)
class _Assigned:
    time_zero: int
    slack: int
    contradicted: bool = False


class Assignments:
    """Scenarios of a vehicle class and the vehicles that they hold for."""

    def __init__(self, profile: VehicleProfile) -> None:
        self._profile = profile
        self._scenarios: dict[str, Scenario] = {}
        self._assigned: dict[tuple[str, int], _Assigned] = {}
        self.table: CutTable = compile_cuts((), profile)

    def assign(self, slot: int, scenario: Scenario, time_zero: int, clock_offset: float) -> None:
        """Let a scenario cut a vehicle; the same assignment again changes nothing."""
        if self._scenarios.get(scenario.name) != scenario:
            scenarios = {**self._scenarios, scenario.name: scenario}
            self.table = compile_cuts(tuple(scenarios[name] for name in sorted(scenarios)), self._profile)
            self._scenarios = scenarios
            for (name, _), assigned in self._assigned.items():
                assigned.contradicted &= name != scenario.name
        slack = int(np.ceil(clock_offset * 1e9))
        known = self._assigned.get((scenario.name, slot))
        if known is None or (known.time_zero, known.slack) != (time_zero, slack):
            self._assigned[scenario.name, slot] = _Assigned(time_zero, slack)

    def unassign(self, slot: int, scenario: str) -> None:
        """Let a scenario no longer cut a vehicle."""
        self._assigned.pop((scenario, slot), None)

    def contradicted(self) -> set[int]:
        """Slots of the vehicles of which a scenario turned out to be false."""
        return {slot for (_, slot), assigned in self._assigned.items() if assigned.contradicted}

    def active(self, slots: NDArray[np.intp], times: Ints) -> NDArray[np.bool_]:
        """Which cuts (B, K, C) hold for the vehicles of ``slots`` (B,) at ``times`` (B, K) ns."""
        result = np.zeros((*times.shape, self.table.count), dtype=bool)
        place = {int(slot): row for row, slot in enumerate(slots)}
        groups: dict[tuple[str, int], list[tuple[int, int]]] = {}
        for (name, slot), assigned in self._assigned.items():
            if slot in place and not assigned.contradicted:
                groups.setdefault((name, assigned.slack), []).append((place[slot], assigned.time_zero))
        for (name, slack), members in groups.items():
            rows = np.array([row for row, _ in members])
            zeros = np.array([zero for _, zero in members], dtype=np.int64)
            result[rows] |= activity(self.table, self._scenarios, name, times[rows] - zeros[:, None], slack)
        return result

    def contradict(self, slot: int, vehicle: str, t: int, empty: NDArray[np.bool_] | None) -> list[EngineEvent]:
        """Stop cutting a vehicle by the scenarios that left nothing, (K, C) or all of its scenarios; tell once."""
        if empty is None:
            guilty = {name: "" for (name, s), a in self._assigned.items() if s == slot and not a.contradicted}
        else:
            guilty = {}
            for c in np.flatnonzero(empty.any(axis=0)):
                guilty.setdefault(self.table.scenario[c], self.table.names[c])
        events = []
        for name, predicate in guilty.items():
            assigned = self._assigned.get((name, slot))
            if assigned is None or assigned.contradicted:
                continue
            assigned.contradicted = True
            elapsed = (t - assigned.time_zero) / 1e9
            by = f" ({predicate})" if predicate else ""
            message = (
                f"scenario {name}{by} contradicts what was measured at {elapsed:.3f} s: it no longer cuts {vehicle}"
            )
            events.append(
                EngineEvent(
                    EventKind.CONTRADICTION,
                    vehicle,
                    t,
                    message,
                    {"scenario": name, "predicate": predicate, "elapsed": elapsed},
                )
            )
        return events

    def describe(self, slots: NDArray[np.intp], cut: NDArray[np.bool_]) -> tuple[tuple[Cut, ...], ...]:
        """For each vehicle the predicates that acted, from (B, N, C)."""
        described = []
        for row in range(len(slots)):
            ranges: dict[tuple[str, str], tuple[int, int]] = {}
            for step, c in zip(*np.nonzero(cut[row]), strict=True):
                key = (self.table.scenario[c], self.table.names[c])
                first, last = ranges.get(key, (int(step) + 1, int(step) + 1))
                ranges[key] = (min(first, int(step) + 1), max(last, int(step) + 1))
            described.append(tuple(Cut(name, predicate, *span) for (name, predicate), span in ranges.items()))
        return tuple(described)
