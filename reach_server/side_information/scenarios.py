"""Which scenario cuts which vehicle, how far each vehicle is in it, and when a scenario turned out to be false."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Cut, EventKind, VehicleProfile
from reach_server.data.events import EngineEvent
from reach_server.data.window import Block
from reach_server.numeric.slot_table import distinct, grow_rows, take_rows
from reach_server.numeric.types import FloatArray, IndexArray, IntArray
from reach_server.predicates import Context, ContextCache, Literals
from reach_server.predicates.apply import Contexts, StepContexts
from reach_server.side_information.tracker import ASSUME, ScenarioTracker
from reach_server.side_information.verdict import verdict
from side_info import Scenario
from side_info.progression import DEAD, TRUE, Grid, Table

#: Obligations after which those are forgotten that no vehicle has any more.
MOST_OBLIGATIONS: Final = 100_000
#: Branches of one track at one step.
MOST_BRANCHES: Final = 8
#: Names of a requirement's two formulas, of which one ends when the requirement is settled.
HOLDS: Final = "holds "
FAILS: Final = "fails "


@dataclass(frozen=True, slots=True, eq=False)
class InitialConditions:
    """When and from where tubes of some vehicles start: ``slots`` (B,), stamps ``t`` (B,) ns, and a box around each
    true state then, ``lower`` and ``upper`` (B, n)."""

    slots: IndexArray
    t: IntArray
    lower: FloatArray
    upper: FloatArray


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
        self._received = received
        self._courses: dict[str, ScenarioTracker] = {}
        #: Stamp of the sample that began the current trajectory, by slot; 0 where none was seen.
        self._began = np.zeros(0, dtype=np.int64)
        #: (epoch, seq) of that sample; stamps may go backwards.
        self._began_as: dict[int, tuple[int, int]] = {}

    def assign(self, slot: int, scenario: Scenario, time_zero: int, clock_offset: float) -> list[int]:
        """Let a scenario cut a vehicle; the same assignment again changes nothing. Slots for which something changed.

        Another document of the same name replaces it for every vehicle that takes part, from its time zero on.
        """
        course = before = self._courses.get(scenario.name)
        if course is None or course.scenario.text != scenario.text:
            course = self._replace(course, scenario)
        replaced = np.flatnonzero(course.assigned).tolist() if course is not before else []
        self._began = grow_rows(self._began, slot + 1, self._began)
        return [slot, *replaced] if course.assign(slot, time_zero, int(np.ceil(clock_offset * 1e9))) else replaced

    def _replace(self, before: ScenarioTracker | None, scenario: Scenario) -> ScenarioTracker:
        index = scenario.state_indices(self._profile)
        speed = np.zeros(len(self._profile.state))
        for name, bound in scenario.speed.items():
            speed[index[name]] = bound
        normals = {ASSUME: scenario.side_information}
        for name, requirement in scenario.requirements.items():
            normals |= {HOLDS + name: requirement.holds, FAILS + name: requirement.fails}

        def root(formula: str, grid: Grid, lead: int) -> int:
            def literal(number: int, margin_ns: int) -> int:
                predicate = scenario.predicates[number]
                made = self.literals.add(
                    predicate, index, scenario=scenario.name, name=predicate.name, speed=speed, margin_ns=margin_ns
                )
                course.pursuits[formula].literals.add(made)
                return made

            return self.table.add(normals[formula], grid, literal, lead=lead)

        formulas = {name: partial(root, name) for name in normals}
        course = ScenarioTracker(scenario, self.table, self._profile.sample_time_ns, self.horizon + 1, formulas)
        course.take_over(before)
        self._courses[scenario.name] = course
        return course

    def course(self, scenario: str) -> ScenarioTracker:
        """A scenario of the class and how far its vehicles are in it."""
        return self._courses[scenario]

    def unassign(self, slot: int, scenario: str) -> None:
        """Let a scenario no longer cut a vehicle."""
        course = self._courses.get(scenario)
        if course is not None:
            course.drop(slot)
            self._drop_idle()

    def drop(self, slot: int) -> None:
        """Forget a vehicle: it takes part in nothing, and nothing is known of its trajectory."""
        for course in self._courses.values():
            course.drop(slot)
        self._drop_idle()
        if slot < len(self._began):
            self._began[slot] = 0
        self._began_as.pop(slot, None)

    def forget_beginning(self, slot: int) -> None:
        """What began last of a vehicle may have had a number that was wrong: whichever begins next counts."""
        self._began_as.pop(slot, None)

    def _drop_idle(self) -> None:
        """Forget the scenarios that no vehicle takes part in."""
        self._courses = {name: course for name, course in self._courses.items() if course.assigned.any()}

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
            for course in self._courses.values()
            for slot in np.flatnonzero(course.assigned & course.contradicted).tolist()
        }

    def receive(
        self, slots: IndexArray, names: Sequence[str], newest: IntArray, block: Callable[[IndexArray, int], Block]
    ) -> list[EngineEvent]:
        """Take in what has been measured of some vehicles (B,) since the last time; what that contradicts.

        ``newest`` (B,) are their newest stamps; ``block`` gives their newest samples, fewer than it is asked for only
        where there are no more.
        """
        events: list[EngineEvent] = []
        if len(self.table) > MOST_OBLIGATIONS:
            self._forget()
        for course in self._courses.values():
            course.grow(int(slots.max(initial=-1)) + 1)
            course.resynchronise(slots, newest)
            waiting = slots[course.unseen(slots, newest) & self._speaks(course, slots) & course.followed(slots)]
            lost = self._see_all(course, waiting, block)
            lost += self._see_all(course, course.again(), block)
            for slot, t, literals in lost:
                events += self._contradict(course, slot, names[slot], t, literals)
        return events

    def _see_all(
        self, course: ScenarioTracker, slots: IndexArray, block: Callable[[IndexArray, int], Block]
    ) -> list[tuple[int, int, tuple[int, ...]]]:
        """All samples of some vehicles that are new to a scenario; as ``_see``."""
        lost: list[tuple[int, int, tuple[int, ...]]] = []
        length = 2
        while len(slots):
            # Usually one sample has come: the window is looked through as far back as is needed only.
            samples = block(slots, length)
            more = course.unseen(slots, samples.t[:, 0]) & samples.valid[:, 0] & (samples.t.shape[1] == length)
            if not more.all():
                lost += self._see(course, slots[~more], take_rows(samples, ~more))
            slots, length = slots[more], 4 * length
        return lost

    def _forget(self) -> None:
        """Keep of the table what is believed of some vehicle."""
        live = [belief for course in self._courses.values() for belief in course.beliefs()]
        self.table, numbers = self.table.renewed(live)
        for course in self._courses.values():
            course.move(self.table, numbers)

    def _speaks(self, course: ScenarioTracker, slots: IndexArray) -> NDArray[np.bool_]:
        """Which vehicles take part in a scenario with their current trajectory."""
        assigned = course.assigned[slots]
        if course.scenario.time_zero is not None:
            return assigned
        self._began = grow_rows(self._began, int(slots.max(initial=-1)) + 1, self._began)
        return np.asarray(assigned & (course.zero[slots] >= self._began[slots]))

    def _see(
        self, course: ScenarioTracker, slots: IndexArray, samples: Block
    ) -> list[tuple[int, int, tuple[int, ...]]]:
        """Samples oldest first; (slot, stamp, literals) where a scenario was contradicted."""
        lost: list[tuple[int, int, tuple[int, ...]]] = []
        new = course.unseen(slots[:, None], samples.t) & samples.valid
        samples = take_rows(samples, (slice(None), slice(int(np.argmax(new.any(axis=0))), None)))
        count = samples.t.shape[1]
        own = np.array(sorted(course.literals(slots)), dtype=np.intp)
        t, x = samples.t.reshape(-1), samples.x.reshape(-1, samples.x.shape[2])
        known = self._status_of_received(course, t, x, np.repeat(slots, count), own)
        by_sample = known.reshape(len(slots), count, len(own))
        # Stamps ahead of a later sample's were wrong: the clock has been set back since.
        valid = samples.valid & (samples.t <= np.minimum.accumulate(samples.t[:, ::-1], axis=1)[:, ::-1])
        for column in range(count):
            rows = np.flatnonzero(valid[:, column])
            t = samples.t[rows, column]
            status = partial(_looked_up, by_sample[rows, column], own)
            for row in np.flatnonzero(course.see(slots[rows], t, status)).tolist():
                slot = int(slots[rows[row]])
                asked = course.asked(course.pursuits[ASSUME].before[[slot]])
                false = asked[status(asked, np.array([row]))[0] < 0].tolist()
                lost.append((slot, int(t[row]), course.needed(slot, false)))
        return lost

    def _status_of_received(
        self, course: ScenarioTracker, t: IntArray, x: FloatArray, slots: IndexArray, literals: IndexArray
    ) -> NDArray[np.int8]:
        """Status (R, L) of literals at samples (R,)."""
        if self._received is None:
            return np.zeros((len(t), len(literals)), dtype=np.int8)
        half = np.abs(self._received).sum(axis=1)
        context = self.context(course, InitialConditions(slots, t, x - half, x + half), np.zeros(len(t), dtype=np.intp))
        generators = np.broadcast_to(self._received, (len(t), *self._received.shape))
        status = self.literals.verdict(literals.tolist(), x, generators, context)
        # Of a received sample itself the way from the last one is not known.
        status[:, self.literals.looks_back[literals]] = 0
        return status

    def obligations(self, slots: IndexArray) -> tuple[IndexArray, NDArray[np.int64], NDArray[np.bool_]]:
        """What the scenarios ask of vehicles (B,) from their newest sample on: row (R,) of ``slots``, ascending, and
        obligation (R,), several where more than one may hold; and of which the newest sample may be cut (B,)."""
        beliefs = np.full((len(slots), len(self._courses)), self.table.belief([TRUE]), dtype=np.int64)
        tested = np.ones(len(slots), dtype=bool)
        for column, course in enumerate(self._courses.values()):
            course.grow(int(slots.max(initial=-1)) + 1)
            acts = self._speaks(course, slots) & ~course.contradicted[slots] & course.started(slots)
            beliefs[acts, column] = course.pursuits[ASSUME].before[slots[acts]]
            tested &= ~acts | course.tested[slots]
        if not self._courses:
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
        return any(course.scenario.requirements for course in self._courses.values())

    def contexts(self, instants: InitialConditions) -> StepContexts:
        """What predicates refer to at the instants and after them."""
        return _Ahead(self, instants)

    def context(self, course: ScenarioTracker, instants: InitialConditions, k: NDArray[np.intp]) -> Context:
        """What the predicates of a scenario refer to ``k`` (B,) steps after the instants."""
        last = (instants.t - course.zero[instants.slots]) / 1e9
        t = last + k * (self._profile.sample_time_ns / 1e9)
        slack = float(course.slack[instants.slots].max(initial=0)) / 1e9
        return Context(t, k.astype(np.float64), last, instants.lower, instants.upper, slack)

    def verdicts(
        self, instants: InitialConditions, sets: Sequence[tuple[FloatArray, FloatArray]]
    ) -> tuple[Mapping[str, str], ...]:
        """For each vehicle (B,) what its requirements come to on sets of true states, (center, generators) at steps 1
        to N; the requirement's name has the scenario's before it."""
        found: list[dict[str, str]] = [{} for _ in instants.slots]
        for name, course in self._courses.items():
            rows = np.flatnonzero(self._speaks(course, instants.slots) & course.started(instants.slots))
            for requirement in course.scenario.requirements if len(rows) else ():
                holds, fails = (
                    self._ahead(course, kind + requirement, instants, rows, sets) for kind in (HOLDS, FAILS)
                )
                settled = self.table.belief([TRUE])
                for place, row in enumerate(rows.tolist()):
                    found[row][f"{name}.{requirement}"] = verdict(holds[place], fails[place], settled, DEAD)
        return tuple(found)

    def _ahead(
        self,
        course: ScenarioTracker,
        formula: str,
        instants: InitialConditions,
        rows: IndexArray,
        sets: Sequence[tuple[FloatArray, FloatArray]],
    ) -> list[list[int]]:
        """Beliefs about a formula after steps 0 (the newest sample) to N."""
        beliefs = course.pursuits[formula].after[instants.slots[rows]]
        ahead = [beliefs]
        for k, (center, generators) in enumerate(sets, 1):
            literals = course.asked(beliefs)
            false = np.zeros((len(rows), len(literals)), dtype=bool)
            if len(literals) and self._received is not None:
                context = self.context(course, take_rows(instants, rows), np.full(len(rows), k))
                false = self.literals.verdict(literals.tolist(), center[rows], generators[rows], context) < 0
            beliefs = course.go_on(beliefs, literals, false)
            ahead.append(beliefs)
        found: list[list[int]] = np.stack(ahead, axis=1).tolist()
        return found

    def contradict(
        self, slot: int, vehicle: str, t: int, literals: Sequence[int] | None, ahead: int = 0
    ) -> list[EngineEvent]:
        """Stop cutting a vehicle by the scenarios of some literals that left nothing, or by all that ask something;
        ``ahead``: how many ns after the stamp ``t`` nothing was left."""
        events: list[EngineEvent] = []
        asking = {name for name, course in self._courses.items() if course.asks(slot)}
        owners = {self.literals.scenario(literal) for literal in literals or ()} or asking
        for name in sorted(owners):
            course = self._courses[name]
            own = tuple(o for o in literals or () if self.literals.scenario(o) == name)
            events += self._contradict(course, slot, vehicle, t, own, ahead)
        return events

    def of_others(self, active: NDArray[np.bool_], responsible: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Literals (L,) among those that ``active`` of scenarios that none of the ``responsible`` ones belongs to."""
        owners = {self.literals.scenario(i) for i in np.flatnonzero(responsible).tolist()}
        others = [self.literals.scenario(i) not in owners for i in range(len(active))]
        return np.asarray(active & np.array(others, dtype=bool))

    def _contradict(
        self, course: ScenarioTracker, slot: int, vehicle: str, t: int, literals: Sequence[int], ahead: int = 0
    ) -> list[EngineEvent]:
        if slot >= len(course.assigned) or not course.assigned[slot] or course.contradicted[slot]:
            return []
        course.contradicted[slot] = True
        name = course.scenario.name
        elapsed = (t + ahead - int(course.zero[slot])) / 1e9
        predicates = ", ".join(dict.fromkeys(self.literals.name(literal) for literal in literals))
        by = f" ({predicates})" if predicates else ""
        what = "what can be reached" if ahead else "what was measured"
        message = f"scenario {name}{by} contradicts {what} at {elapsed:.3f} s: it no longer cuts {vehicle}"
        details = {"scenario": name, "predicate": predicates, "elapsed": elapsed}
        return [EngineEvent(EventKind.CONTRADICTION, vehicle, t, message, details)]

    def describe(self, active: NDArray[np.bool_]) -> tuple[tuple[Cut, ...], ...]:
        """For each vehicle the predicates that acted, from (B, N, L) over steps 1 to N."""
        owners = [(self.literals.scenario(i), self.literals.name(i)) for i in range(active.shape[2])]
        predicates = list(dict.fromkeys(owners))
        if len(predicates) < len(owners):
            # The same predicate at several margins.
            merged = np.zeros((*active.shape[:2], len(predicates)), dtype=bool)
            for literal, owner in enumerate(owners):
                merged[..., predicates.index(owner)] |= active[..., literal]
            active = merged
        steps = active.shape[1]
        first, last = active.argmax(axis=1) + 1, steps - active[:, ::-1].argmax(axis=1)
        # Most vehicles of a fleet are cut in one of a few ways.
        ways, which = distinct(np.where(active.any(axis=1), first * (steps + 1) + last, 0))
        described = [
            tuple(
                Cut(*predicate, *divmod(span, steps + 1))
                for predicate, span in zip(predicates, way, strict=True)
                if span
            )
            for way in ways
        ]
        return tuple(described[way] for way in which.tolist())


def _looked_up(known: NDArray[np.int8], own: IndexArray, literals: IndexArray, rows: IndexArray) -> NDArray[np.int8]:
    """Status (K, L) of some literals at some rows, out of that of all of a scenario's ``own`` at all rows."""
    return known[rows][:, np.searchsorted(own, literals)]


class _Ahead:
    """Contexts of the steps of a horizon: one series for each scenario that is asked for."""

    def __init__(self, assignments: Assignments, instants: InitialConditions) -> None:
        self._assignments = assignments
        self._instants = instants
        self._series: dict[str, ContextCache] = {}

    def __call__(self, k: int, track: IndexArray) -> Contexts:
        """At step ``k``, for sets of rows (R,) of the instants."""
        return partial(self._of, k, track)

    def _of(self, k: int, row: IndexArray, literal: int, rows: IndexArray) -> Context:
        made, count = self._assignments, len(self._instants.slots)
        scenario = made.literals.scenario(literal)
        if scenario not in self._series:
            steps = made.horizon + 1
            every = take_rows(self._instants, np.tile(np.arange(count), steps))
            whole = made.context(made.course(scenario), every, np.repeat(np.arange(steps), count))
            self._series[scenario] = ContextCache(whole)
        whole = self._series[scenario].context
        place = k * count + row[rows]
        return Context(
            whole.t[place], whole.k[place], whole.last_t[place], whole.last_lower[place], whole.last_upper[place],
            whole.t_slack, self._series[scenario], place,
        )  # fmt: skip
