"""What a requirement comes to on a tube: satisfied, violated, or why that is not known."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray, IndexArray
from reach_server.predicates import Literals
from reach_server.side_information.contexts import InitialConditions, context_ahead
from reach_server.side_information.tracker import ScenarioTracker

#: Names of a requirement's two formulas, of which one ends when the requirement is settled.
HOLDS: Final = "holds "
FAILS: Final = "fails "

SATISFIED = "satisfied"
VIOLATED = "violated"


def verdict(holds: Sequence[int], fails: Sequence[int], settled: int, dead: int) -> str:
    """The verdict about a requirement from the beliefs about it and about its negation after steps 0 to N.

    ``dead`` is the belief that nothing can make a formula true any more, ``settled`` the one that nothing is asked any
    more. The sets are outer bounds, so that only a dead belief is certain:

    * ``satisfied``: its negation is dead; ``violated``: it is dead itself;
    * ``undecided (size)``: within the horizon it may be settled either way, the sets are too large to tell;
    * ``undecided (time)``: what decides lies beyond the horizon, or has one outcome only as yet;
    * ``undecided (past)``: it may have been violated by what was measured with noise, or not received.

    Where it can be violated within the horizon, the first step at which is named [LA24].
    """
    if dead in fails:
        return SATISFIED
    if dead in holds:
        return VIOLATED
    if fails[0] == settled:
        return "undecided (past)"
    reason = "size" if settled in holds and settled in fails else "time"
    return f"undecided ({reason})" + (f", may be violated at step {fails.index(settled)}" if settled in fails else "")


def beliefs_ahead(
    tracker: ScenarioTracker,
    formula: str,
    literals: Literals,
    instants: InitialConditions,
    rows: IndexArray,
    sets: Sequence[tuple[FloatArray, FloatArray]],
    *,
    known: bool,
    step_ns: int,
) -> list[list[int]]:
    """Beliefs about a formula after steps 0 (the newest sample) to N, of vehicles in some rows (K,) of the instants.

    ``sets`` are those of true states, (center, generators), at steps 1 to N. Unless it is ``known`` how far received
    states may be from true ones, no literal is taken as false.
    """
    beliefs = tracker.formula_states[formula].after[instants.slots[rows]]
    ahead = [beliefs]
    for k, (center, generators) in enumerate(sets, 1):
        asked = tracker.asked(beliefs)
        false = np.zeros((len(rows), len(asked)), dtype=bool)
        if len(asked) and known:
            context = context_ahead(tracker, take_rows(instants, rows), np.full(len(rows), k), step_ns)
            false = literals.verdict(asked.tolist(), center[rows], generators[rows], context) < 0
        beliefs = tracker.go_on(beliefs, asked, false)
        ahead.append(beliefs)
    found: list[list[int]] = np.stack(ahead, axis=1).tolist()
    return found
