"""Which scenario cuts which vehicle of a class, and what the scenarios of a vehicle ask of it together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Cut, VehicleProfile
from reach_server.data.events import EngineEvent
from reach_server.numeric.slot_table import distinct, grow_rows
from reach_server.numeric.types import FloatArray, IndexArray, IntArray
from reach_server.predicates import Literals
from reach_server.predicates.apply import StepContexts
from reach_server.side_information import contradictions
from reach_server.side_information.contexts import HorizonContexts, InitialConditions
from reach_server.side_information.contradictions import Blocks, SampleObserver
from reach_server.side_information.cut_listing import list_cuts
from reach_server.side_information.tracker import ASSUME, ScenarioTracker
from reach_server.side_information.verdict import FAILS, HOLDS, beliefs_ahead, verdict
from side_info import Scenario
from side_info.progression import DEAD, TRUE, Grid, Table
from side_info.stl.nnf import Normal

__all__ = ["MOST_BRANCHES", "MOST_OBLIGATIONS", "Assignments", "InitialConditions"]

#: Obligations after which those are forgotten that no vehicle has any more.
MOST_OBLIGATIONS: Final = 100_000
#: Predicates of documents that are in force no more, after which these are forgotten.
MOST_UNUSED: Final = 64
#: Branches of one track at one step.
MOST_BRANCHES: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class FormulaRoot:
    """What makes the obligation of a formula of a scenario at its first place, by grid and lead.

    An object rather than a function of its surroundings, so that a checkpoint can hold it. ``index`` has the states of
    the scenario among those of the class, ``speed`` (n,) how fast these change at most; ``literals`` are those that
    the formula has been given.
    """

    assignments: "Assignments"
    scenario: Scenario
    normal: Normal
    index: Mapping[str, int]
    speed: FloatArray
    literals: set[int] = field(default_factory=set)

    def __call__(self, grid: Grid, lead: int) -> int:
        """The obligation from the sample of grid index ``-lead`` on, in the table of now."""
        return self.assignments.table.add(self.normal, grid, self._literal, lead=lead)

    def _literal(self, number: int, margin_ns: int) -> int:
        predicate, name = self.scenario.predicates[number], self.scenario.name
        made = self.assignments.literals.add(
            predicate, self.index, scenario=name, name=predicate.name, speed=self.speed, margin_ns=margin_ns
        )
        self.literals.add(made)
        return made


class Assignments:
    """Scenarios of a vehicle class and the vehicles that they hold for.

    Args:
        profile: the class.
        noise: generators (n, g) by which the states that the cut sets speak about may differ from true ones; None if
            that is not known, so that nothing cuts.
        received: generators (n, g) by which received states may; None likewise, so that nothing can be contradicted.
    """

    def __init__(
        self, profile: VehicleProfile, noise: FloatArray | None, received: FloatArray | None, horizon: int | None = None
    ) -> None:
        self._profile = profile
        self.horizon = horizon or profile.horizon
        n = len(profile.state)
        self.plane = profile.position if n >= 2 and profile.position[0] != profile.position[1] else None
        self.table = Table()
        self.literals = Literals(n, self.plane, noise)
        self._received_known = received is not None
        self._observer = SampleObserver(self.literals, received, profile.sample_time_ns)
        self._trackers: dict[str, ScenarioTracker] = {}
        #: Stamp of the sample that began the current trajectory, by slot; 0 where none was seen.
        self._began = np.zeros(0, dtype=np.int64)
        #: (epoch, seq) of that sample; stamps may go backwards.
        self._began_as: dict[int, tuple[int, int]] = {}

    def assign(self, slot: int, scenario: Scenario, time_zero: int, clock_offset: float) -> list[int]:
        """Let a scenario cut a vehicle; the same assignment again changes nothing. Slots for which something changed.

        Another document of the same name replaces it for every vehicle that takes part, from its time zero on.
        """
        tracker = before = self._trackers.get(scenario.name)
        if tracker is None or tracker.scenario.text != scenario.text:
            tracker = self._replace(tracker, scenario)
        replaced = np.flatnonzero(tracker.assigned).tolist() if tracker is not before else []
        self._began = grow_rows(self._began, slot + 1, self._began)
        return [slot, *replaced] if tracker.assign(slot, time_zero, int(np.ceil(clock_offset * 1e9))) else replaced

    def _replace(self, before: ScenarioTracker | None, scenario: Scenario) -> ScenarioTracker:
        index = scenario.state_indices(self._profile)
        speed = np.zeros(len(self._profile.state))
        for name, bound in scenario.speed.items():
            speed[index[name]] = bound
        normals = {ASSUME: scenario.side_information}
        for name, requirement in scenario.requirements.items():
            normals |= {HOLDS + name: requirement.holds, FAILS + name: requirement.fails}

        formulas = {name: FormulaRoot(self, scenario, normal, index, speed) for name, normal in normals.items()}
        tracker = ScenarioTracker(scenario, self.table, self._profile.sample_time_ns, self.horizon + 1, formulas)
        for name, root in formulas.items():
            tracker.formula_states[name].literals = root.literals
        tracker.take_over(before)
        self._trackers[scenario.name] = tracker
        self._release()
        return tracker

    def tracker(self, scenario: str) -> ScenarioTracker:
        """A scenario of the class and how far its vehicles are in it."""
        return self._trackers[scenario]

    def unassign(self, slot: int, scenario: str) -> None:
        """Let a scenario no longer cut a vehicle."""
        tracker = self._trackers.get(scenario)
        if tracker is not None:
            tracker.drop(slot)
            self._drop_idle()

    def drop(self, slot: int) -> None:
        """Forget a vehicle: it takes part in nothing, and nothing is known of its trajectory."""
        for tracker in self._trackers.values():
            tracker.drop(slot)
        self._drop_idle()
        if slot < len(self._began):
            self._began[slot] = 0
        self._began_as.pop(slot, None)

    def forget_beginning(self, slot: int) -> None:
        """What began last of a vehicle may have had a number that was wrong: whichever begins next counts."""
        self._began_as.pop(slot, None)

    def _drop_idle(self) -> None:
        """Forget the scenarios that no vehicle takes part in."""
        self._trackers = {name: tracker for name, tracker in self._trackers.items() if tracker.assigned.any()}
        self._release()

    def _release(self) -> None:
        """Forget the predicates that no scenario in force asks for, once they are many."""
        live = {
            literal
            for t in self._trackers.values()
            for state in t.formula_states.values()
            for literal in state.literals
        }
        if self.literals.held > len(live) + MOST_UNUSED:
            # What the old table and what was scheduled by it say about the numbers must not outlive their meaning.
            self._forget()
            self.literals.release(live)

    def began(self, slots: IndexArray, t: IntArray, order: Sequence[tuple[int, int]]) -> None:
        """Trajectories begin (B,): a scenario that begins with the vehicle says nothing about a later trajectory."""
        self._began = grow_rows(self._began, int(slots.max()) + 1, self._began)
        for slot, stamp, key in zip(slots.tolist(), t.tolist(), order, strict=True):
            if key > self._began_as.get(slot, (-1, -1)):
                self._began[slot], self._began_as[slot] = stamp, key

    def contradicted(self) -> set[int]:
        """Slots of the vehicles of which a scenario turned out to be false."""
        return {
            slot
            for tracker in self._trackers.values()
            for slot in np.flatnonzero(tracker.assigned & tracker.contradicted).tolist()
        }

    def receive(self, slots: IndexArray, names: Sequence[str], newest: IntArray, block: Blocks) -> list[EngineEvent]:
        """Take in what has been measured of some vehicles (B,) since the last time; what that contradicts.

        ``newest`` (B,) are their newest stamps; ``block`` gives their newest samples, fewer than it is asked for only
        where there are no more.
        """
        events: list[EngineEvent] = []
        if len(self.table) > MOST_OBLIGATIONS:
            self._forget()
        for tracker in self._trackers.values():
            tracker.grow(int(slots.max(initial=-1)) + 1)
            tracker.resynchronise(slots, newest)
            waiting = slots[tracker.unseen(slots, newest) & self._speaks(tracker, slots) & tracker.followed(slots)]
            found = self._observer.observe(tracker, waiting, block)
            found += self._observer.observe(tracker, tracker.replay(), block)
            for slot, t, literals in found:
                events += contradictions.end(tracker, self.literals, slot, names[slot], t, literals)
        return events

    def _forget(self) -> None:
        """Keep of the table what is believed of some vehicle."""
        live = [belief for tracker in self._trackers.values() for belief in tracker.beliefs()]
        self.table, numbers = self.table.renewed(live)
        for tracker in self._trackers.values():
            tracker.rebase(self.table, numbers)

    def _speaks(self, tracker: ScenarioTracker, slots: IndexArray) -> NDArray[np.bool_]:
        """Which vehicles take part in a scenario with their current trajectory."""
        assigned = tracker.assigned[slots]
        if tracker.scenario.time_zero is not None:
            return assigned
        self._began = grow_rows(self._began, int(slots.max(initial=-1)) + 1, self._began)
        return np.asarray(assigned & (tracker.zero[slots] >= self._began[slots]))

    def obligations(self, slots: IndexArray) -> tuple[IndexArray, NDArray[np.int64], NDArray[np.bool_]]:
        """What the scenarios ask of vehicles (B,) from their newest sample on: row (R,) of ``slots``, ascending, and
        obligation (R,), several where more than one may hold; and of which the newest sample may be cut (B,)."""
        beliefs = np.full((len(slots), len(self._trackers)), self.table.belief([TRUE]), dtype=np.int64)
        tested = np.ones(len(slots), dtype=bool)
        for column, tracker in enumerate(self._trackers.values()):
            tracker.grow(int(slots.max(initial=-1)) + 1)
            acts = self._speaks(tracker, slots) & ~tracker.contradicted[slots] & tracker.started(slots)
            beliefs[acts, column] = tracker.formula_states[ASSUME].before[slots[acts]]
            tested &= ~acts | tracker.tested[slots]
        if not self._trackers:
            return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.int64), tested
        cases, which = distinct(beliefs)
        options = [self._joint(tuple(case)) for case in cases]
        sizes = np.array([len(o) for o in options], dtype=np.intp)
        first, counts = (np.cumsum(sizes) - sizes)[which], sizes[which]
        rows = np.repeat(np.arange(len(slots)), counts)
        within = np.arange(len(rows)) - np.repeat(np.cumsum(counts) - counts, counts)
        every = np.array([o for option in options for o in option], dtype=np.int64)
        return rows, every[first[rows] + within], tested

    def _joint(self, beliefs: tuple[int, ...]) -> tuple[int, ...]:
        """Obligations of which one holds, given a belief about each scenario; none where nothing is asked."""
        joint: tuple[int, ...] = (TRUE,)
        for belief in beliefs:
            members = self.table.members(belief)
            joint = self.table.antichain([self.table.conjunction((a, b)) for a in joint for b in members])
            weaker = self.table.cap(joint, MOST_BRANCHES)
            joint = self.table.antichain([weaker[o] for o in joint])
        return () if joint == (TRUE,) else joint

    @property
    def requires(self) -> bool:
        """Whether some scenario has requirements."""
        return any(tracker.scenario.requirements for tracker in self._trackers.values())

    def contexts(self, instants: InitialConditions) -> StepContexts:
        """What predicates refer to at the instants and after them."""
        return HorizonContexts(self.literals, self.tracker, instants, self.horizon, self._profile.sample_time_ns)

    def verdicts(
        self, instants: InitialConditions, sets: Sequence[tuple[FloatArray, FloatArray]]
    ) -> tuple[Mapping[str, str], ...]:
        """For each vehicle (B,) what its requirements come to on sets of true states, (center, generators) at steps 1
        to N; the requirement's name has the scenario's before it."""
        found: list[dict[str, str]] = [{} for _ in instants.slots]
        for name, tracker in self._trackers.items():
            rows = np.flatnonzero(self._speaks(tracker, instants.slots) & tracker.started(instants.slots))
            for requirement in tracker.scenario.requirements if len(rows) else ():
                holds, fails = (
                    beliefs_ahead(
                        tracker, kind + requirement, self.literals, instants, rows, sets,
                        known=self._received_known, step_ns=self._profile.sample_time_ns,
                    )
                    for kind in (HOLDS, FAILS)
                )  # fmt: skip
                settled = self.table.belief([TRUE])
                for index, row in enumerate(rows.tolist()):
                    found[row][f"{name}.{requirement}"] = verdict(holds[index], fails[index], settled, DEAD)
        return tuple(found)

    def contradict(
        self, slot: int, vehicle: str, t: int, literals: Sequence[int] | None, ahead: int = 0
    ) -> list[EngineEvent]:
        """Stop cutting a vehicle by the scenarios of some literals that left nothing, or by all that ask something;
        ``ahead``: how many ns after the stamp ``t`` nothing was left."""
        events: list[EngineEvent] = []
        asking = {name for name, tracker in self._trackers.items() if tracker.asks(slot)}
        owners = {self.literals.scenario(literal) for literal in literals or ()} or asking
        for name in sorted(owners):
            tracker = self._trackers[name]
            own = tuple(o for o in literals or () if self.literals.scenario(o) == name)
            events += contradictions.end(tracker, self.literals, slot, vehicle, t, own, ahead)
        return events

    def of_others(self, active: NDArray[np.bool_], responsible: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Literals (L,) among those that ``active`` of scenarios that none of the ``responsible`` ones belongs to."""
        owners = {self.literals.scenario(i) for i in np.flatnonzero(responsible).tolist()}
        others = [self.literals.scenario(i) not in owners for i in range(len(active))]
        return np.asarray(active & np.array(others, dtype=bool))

    def describe(self, active: NDArray[np.bool_]) -> tuple[tuple[Cut, ...], ...]:
        """For each vehicle the predicates that active, from (B, N, L) over steps 1 to N."""
        return list_cuts(self.literals, active)
