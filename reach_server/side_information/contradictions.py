"""When a scenario turns out to be false of a vehicle: by what was measured, or because its cuts left nothing."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import EventKind
from reach_server.data.events import EngineEvent
from reach_server.data.window import Block
from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray, IndexArray, IntArray
from reach_server.predicates import Literals
from reach_server.side_information.contexts import InitialConditions, context_ahead
from reach_server.side_information.tracker import ASSUME, ScenarioTracker

#: (slots (B,), length) to their newest samples, fewer than that only where there are no more.
Blocks = Callable[[IndexArray, int], Block]


class Contradiction(NamedTuple):
    """A sample that contradicts a scenario: of which vehicle, its stamp (ns), and the literals that are false of it."""

    slot: int
    t: int
    literals: tuple[int, ...]


class SampleObserver:
    """Takes received samples into the trackers of scenarios.

    Args:
        literals: the predicates of the class.
        received: generators (n, g) by which received states may differ from true ones; None if that is not known, so
            that nothing can be contradicted.
        step_ns: the sample time of the class.
    """

    def __init__(self, literals: Literals, received: FloatArray | None, step_ns: int) -> None:
        self._literals = literals
        self._received = received
        self._step_ns = step_ns

    def observe(self, tracker: ScenarioTracker, slots: IndexArray, block: Blocks) -> list[Contradiction]:
        """Take in all samples of some vehicles that are new to a scenario; which contradict it."""
        found: list[Contradiction] = []
        length = 2
        while len(slots):
            # Usually one sample has come: the window is looked through as far back as is needed only.
            samples = block(slots, length)
            more = tracker.unseen(slots, samples.t[:, 0]) & samples.valid[:, 0] & (samples.t.shape[1] == length)
            if not more.all():
                found += self._observe(tracker, slots[~more], take_rows(samples, ~more))
            slots, length = slots[more], 4 * length
        return found

    def _observe(self, tracker: ScenarioTracker, slots: IndexArray, samples: Block) -> list[Contradiction]:
        """The same of samples oldest first."""
        found: list[Contradiction] = []
        new = tracker.unseen(slots[:, None], samples.t) & samples.valid
        samples = take_rows(samples, (slice(None), slice(int(np.argmax(new.any(axis=0))), None)))
        count = samples.t.shape[1]
        own = np.array(sorted(tracker.literals(slots)), dtype=np.intp)
        t, x = samples.t.reshape(-1), samples.x.reshape(-1, samples.x.shape[2])
        known = self._status_of_received(tracker, t, x, np.repeat(slots, count), own)
        by_sample = known.reshape(len(slots), count, len(own))
        # Stamps ahead of a later sample's were wrong: the clock has been set back since.
        valid = samples.valid & (samples.t <= np.minimum.accumulate(samples.t[:, ::-1], axis=1)[:, ::-1])
        for column in range(count):
            rows = np.flatnonzero(valid[:, column])
            t = samples.t[rows, column]
            status = partial(_looked_up, by_sample[rows, column], own)
            for row in np.flatnonzero(tracker.observe(slots[rows], t, status)).tolist():
                slot = int(slots[rows[row]])
                asked = tracker.asked(tracker.formula_states[ASSUME].before[[slot]])
                false = asked[status(asked, np.array([row]))[0] < 0].tolist()
                found.append(Contradiction(slot, int(t[row]), tracker.needed(slot, false)))
        return found

    def _status_of_received(
        self, tracker: ScenarioTracker, t: IntArray, x: FloatArray, slots: IndexArray, literals: IndexArray
    ) -> NDArray[np.int8]:
        """Status (R, L) of literals at samples (R,)."""
        if self._received is None:
            return np.zeros((len(t), len(literals)), dtype=np.int8)
        half = np.abs(self._received).sum(axis=1)
        instants = InitialConditions(slots, t, x - half, x + half)
        context = context_ahead(tracker, instants, np.zeros(len(t), dtype=np.intp), self._step_ns)
        generators = np.broadcast_to(self._received, (len(t), *self._received.shape))
        status = self._literals.verdict(literals.tolist(), x, generators, context)
        # Of a received sample itself the way from the last one is not known.
        status[:, self._literals.looks_back[literals]] = 0
        return status


def _looked_up(known: NDArray[np.int8], own: IndexArray, literals: IndexArray, rows: IndexArray) -> NDArray[np.int8]:
    """Status (K, L) of some literals at some rows, out of that of all of a scenario's ``own`` at all rows."""
    return known[rows][:, np.searchsorted(own, literals)]


def end(
    tracker: ScenarioTracker,
    literals: Literals,
    slot: int,
    vehicle: str,
    t: int,
    by: Sequence[int],
    ahead: int = 0,
) -> list[EngineEvent]:
    """Let a scenario cut a vehicle no longer, and what is to be told of it; nothing where it does not cut it.

    ``by`` are the literals that contradict each other or the sample of stamp ``t`` (ns), ``ahead`` how many ns after it
    nothing was left.
    """
    if slot >= len(tracker.assigned) or not tracker.assigned[slot] or tracker.contradicted[slot]:
        return []
    tracker.contradicted[slot] = True
    name = tracker.scenario.name
    elapsed = (t + ahead - int(tracker.zero[slot])) / 1e9
    predicates = ", ".join(dict.fromkeys(literals.name(literal) for literal in by))
    named = f" ({predicates})" if predicates else ""
    what = "what can be reached" if ahead else "what was measured"
    message = f"scenario {name}{named} contradicts {what} at {elapsed:.3f} s: it no longer cuts {vehicle}"
    details = {"scenario": name, "predicate": predicates, "elapsed": elapsed}
    return [EngineEvent(EventKind.CONTRADICTION, vehicle, t, message, details)]
