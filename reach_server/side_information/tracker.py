"""How far the vehicles of a class are in a scenario: what its formulas still may ask for, sample by sample."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.slot_table import distinct, grow_rows
from reach_server.numeric.types import IndexArray, IntArray
from side_info import Scenario
from side_info.progression import DEAD, TRUE, Grid, Table
from side_info.stl.connectives import bounds_ns

#: Name of the formula that is taken as true, beside those of the requirements.
ASSUME = ""

#: (literals, rows (K,)) to their status (K, len(literals)): -1 where a literal surely does not hold.
Status = Callable[[NDArray[np.intp], NDArray[np.intp]], NDArray[np.int8]]


@dataclass(slots=True, eq=False)
class FormulaState:
    """Beliefs about one formula by slot (V,): ``before`` and ``after`` its newest sample (ids of a ``Table``)."""

    literals: set[int] = field(default_factory=set)
    roots: dict[Grid, int] = field(default_factory=dict)
    before: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    after: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


class ScenarioTracker:
    """One scenario and the vehicles that take part in it.

    The grid of a vehicle begins at its time zero and has the step of its class; a sample belongs to its nearest point.
    While all stamps lie on the grid, and all windows end on it, the windows of the formulas are taken as they are. From
    the first stamp that does not, what has been measured is looked at once more, with windows for stamps that are up to
    half a step off. A place without a sample, or with two, is passed without asking any predicate there.
    """

    def __init__(
        self,
        scenario: Scenario,
        table: Table,
        step_ns: int,
        lead: int,
        formulas: Mapping[str, Callable[[Grid, int], int]],
    ) -> None:
        self.scenario = scenario
        self._table = table
        self._step = step_ns
        self._add = dict(formulas)
        self._lead = lead
        requirements = (r for both in scenario.requirements.values() for r in (both.holds, both.fails))
        bounds = (end for formula in (scenario.side_information, *requirements) for end in bounds_ns(formula))
        #: Whether all windows begin and end at places of the grid.
        self._whole = all(end % step_ns == 0 for end in bounds)
        self.formula_states = {name: FormulaState() for name in formulas}
        self.zero = np.zeros(0, dtype=np.int64)
        self.assigned = np.zeros(0, dtype=bool)
        self.contradicted = np.zeros(0, dtype=bool)
        #: Whether the newest sample has a place of its own, so that predicates may be asked of it.
        self.tested = np.zeros(0, dtype=bool)
        self.slack = np.zeros(0, dtype=np.int64)
        self._index = np.zeros(0, dtype=np.int64)
        self._seen = np.zeros(0, dtype=np.int64)
        self._jitters = np.zeros(0, dtype=bool)
        self._started = np.zeros(0, dtype=bool)
        #: Places before time zero from which on formulas are followed.
        self._before = np.zeros(0, dtype=np.int64)
        self._to_replay: set[int] = set()

    def grow(self, slots: int) -> None:
        """Make room for ``slots`` vehicles."""
        if slots <= len(self.zero):
            return
        for name in (
            "zero", "slack", "assigned", "contradicted", "tested",
            "_index", "_seen", "_jitters", "_started", "_before",
        ):  # fmt: skip
            array = getattr(self, name)
            setattr(self, name, grow_rows(array, slots, array))
        for state in self.formula_states.values():
            state.before = grow_rows(state.before, slots, state.before)
            state.after = grow_rows(state.after, slots, state.after)

    def assign(self, slot: int, zero: int, slack: int) -> bool:
        """Let a vehicle take part, from its time zero (ns) known up to ``slack`` ns; whether that is anything new."""
        self.grow(slot + 1)
        if self.assigned[slot] and (self.zero[slot], self.slack[slot]) == (zero, slack):
            return False
        self.zero[slot], self.slack[slot] = zero, slack
        self.assigned[slot], self.contradicted[slot] = True, False
        self._jitters[slot] = False
        self._restart(slot)
        self._seen[slot] = np.iinfo(np.int64).min
        return True

    def drop(self, slot: int) -> None:
        """Forget a vehicle."""
        if slot < len(self.assigned):
            self.assigned[slot] = self.contradicted[slot] = self._started[slot] = self.tested[slot] = False
            self._to_replay.discard(slot)

    def asks(self, slot: int) -> bool:
        """Whether the scenario asks anything of a vehicle from its newest sample on."""
        if slot >= len(self.assigned) or not (self.assigned[slot] and self._started[slot]):
            return False
        return self._table.members(int(self.formula_states[ASSUME].before[slot])) != (TRUE,)

    def _root(self, name: str, slot: int) -> int:
        """Belief of a vehicle about a formula at its first place."""
        grid = self._grid(slot)
        roots = self.formula_states[name].roots
        if grid not in roots:
            roots[grid] = self._table.belief([self._add[name](grid, int(self._before[slot]))])
        return roots[grid]

    def _grid(self, slot: int) -> Grid:
        slack = int(self.slack[slot])
        # Between the last place of a window and its end a stamp may come that is the first to stray.
        exact = self._whole and slack % self._step == 0 and not self._jitters[slot]
        return Grid(self._step, slack, self.scenario.semantics == "continuous", 0 if exact else self._step // 2)

    def _restart(self, slot: int) -> None:
        # Formulas are followed from as many places before time zero as may belong to them after all, and as the horizon
        # has, so that tubes see time zero come.
        self._before[slot] = self._lead + self._grid(slot).lead
        self._index[slot], self._started[slot], self.tested[slot] = -self._before[slot] - 1, False, False
        for name, state in self.formula_states.items():
            state.before[slot] = state.after[slot] = self._root(name, slot)

    def take_over(self, other: "ScenarioTracker | None") -> None:
        """Let the vehicles of an earlier document take part from their time zero on."""
        if other is not None:
            for slot in np.flatnonzero(other.assigned).tolist():
                self.assign(slot, int(other.zero[slot]), int(other.slack[slot]))

    def started(self, slots: IndexArray) -> NDArray[np.bool_]:
        """Which of the vehicles (B,) have had a sample that formulas are followed from."""
        return np.asarray(self._started[slots])

    def resynchronise(self, slots: IndexArray, newest: IntArray) -> None:
        """Where the newest stamps (B,) say that a clock was set back, anything may have been measured meanwhile."""
        back = self.assigned[slots] & (newest < self._seen[slots])
        for slot, t in zip(slots[back].tolist(), newest[back].tolist(), strict=True):
            self._restart(slot)
            self._seen[slot] = t - 1

    def unseen(self, slots: IndexArray, t: IntArray) -> NDArray[np.bool_]:
        """Whether samples of stamps ``t`` (B,) are new to the scenario."""
        return np.asarray(self.assigned[slots] & (self._seen[slots] < t))

    def followed(self, slots: IndexArray) -> NDArray[np.bool_]:
        """Of which vehicles (B,) a formula is still to be followed: after a contradiction only requirements are."""
        return np.asarray(~self.contradicted[slots] | (len(self.formula_states) > 1))

    def literals(self, slots: IndexArray) -> set[int]:
        """Literals that samples of some vehicles are asked for."""
        over = bool(self.contradicted[slots].all())
        return set().union(*(p.literals for name, p in self.formula_states.items() if not (over and name == ASSUME)))

    def observe(self, slots: IndexArray, t: IntArray, status: Status) -> NDArray[np.bool_]:
        """Take in one sample each of some vehicles (B,), stamps ns; which of them contradict the scenario now.

        ``status`` says what surely does not hold at the samples, by rows of ``slots``. Samples that have been seen, and
        those before time zero, change nothing.
        """
        # What a strayed stamp has put in doubt waits until all is looked at once more.
        fresh = self.unseen(slots, t) & ~np.isin(slots, list(self._to_replay))
        self._seen[slots[fresh]] = t[fresh]
        # The nearest place, the later one of two; twice a difference of times may not fit into 64 bits.
        index, rest = np.divmod(t - self.zero[slots], self._step)
        index += 2 * rest >= self._step
        rows = np.flatnonzero(fresh & (index >= -self._before[slots]))
        chosen = slots[rows]
        strays = (t[rows] != self.zero[chosen] + index[rows] * self._step) & ~self._jitters[chosen]
        self._jitters[chosen[strays]] = True
        self._to_replay.update(chosen[strays].tolist())
        rows, chosen = rows[~strays], chosen[~strays]
        repeated = index[rows] == self._index[chosen]
        missing = np.maximum(index[rows] - self._index[chosen] - 1, 0)
        for name, state in self.formula_states.items():
            open_ = ~self.contradicted[chosen] | (name != ASSUME)
            self._pass(state.before, state.after, chosen[open_], repeated[open_], missing[open_])
            asked = open_ & ~repeated
            self._ask(state, chosen[asked], rows[asked], status)
        self.tested[chosen], self._index[chosen], self._started[chosen] = ~repeated, index[rows], True
        lost = np.zeros(len(slots), dtype=bool)
        lost[rows] = (self.formula_states[ASSUME].after[chosen] == DEAD) & ~self.contradicted[chosen]
        return lost

    def replay(self) -> IndexArray:
        """Vehicles whose samples have to be handed over once more, all that are still held; asks once."""
        slots = np.array(sorted(self._to_replay), dtype=np.intp)
        self._to_replay.clear()
        for slot in slots.tolist():
            self._restart(slot)
        self._seen[slots] = np.iinfo(np.int64).min
        return slots

    def _pass(
        self, before: IntArray, after: IntArray, slots: IndexArray, repeated: NDArray[np.bool_], missing: IntArray
    ) -> None:
        """Pass places without a sample, and those with another one."""
        for slot in slots[repeated].tolist():
            after[slot] = self._table.skip(int(before[slot]))
        for row in np.flatnonzero(missing).tolist():
            slot = int(slots[row])
            after[slot] = self._table.skip(int(after[slot]), int(missing[row]))

    def _ask(self, state: FormulaState, slots: IndexArray, rows: IndexArray, status: Status) -> None:
        """Go on with samples at their own places; one table look-up for vehicles in the same case."""
        if not len(slots):
            return
        beliefs = state.before[slots] = state.after[slots]
        literals = self.asked(beliefs)
        state.after[slots] = self.go_on(beliefs, literals, status(literals, rows) < 0)

    def needed(self, slot: int, false: list[int]) -> tuple[int, ...]:
        """Of the literals that were false at the newest sample of a vehicle as few as contradict the scenario."""
        before = int(self.formula_states[ASSUME].before[slot])
        for literal in tuple(false):
            fewer = frozenset(false) - {literal}
            if self._table.after(before, fewer) == DEAD:
                false = sorted(fewer)
        return tuple(false)

    def go_on(self, beliefs: IntArray, literals: NDArray[np.intp], false: NDArray[np.bool_]) -> IntArray:
        """Beliefs (B,) after a sample at which ``false`` (B, K) of the ``literals`` (K,) surely do not hold."""
        cases, which = distinct(np.column_stack([beliefs, false]))
        names = literals.tolist()
        after = [
            self._table.after(belief, frozenset(name for name, off in zip(names, no, strict=True) if off))
            for belief, *no in cases
        ]
        return np.array(after, dtype=np.int64)[which]

    def beliefs(self) -> list[int]:
        """All that is believed of its vehicles."""
        return [int(b) for p in self.formula_states.values() for b in np.unique([p.before, p.after])]

    def rebase(self, table: Table, numbers: Mapping[int, int]) -> None:
        """Go on with another table, in which the beliefs have these ``numbers``."""
        self._table = table
        for state in self.formula_states.values():
            state.roots.clear()
            for beliefs in (state.before, state.after):
                beliefs[:] = [numbers[belief] for belief in beliefs.tolist()]

    def asked(self, beliefs: IntArray) -> NDArray[np.intp]:
        """Literals that some of the beliefs (B,) ask for now, ascending."""
        found = frozenset[int]().union(*map(self._table.literals_of, np.unique(beliefs).tolist()))
        return np.array(sorted(found), dtype=np.intp)
