"""What a requirement comes to on a tube: satisfied, violated, or why that is not known."""

from collections.abc import Sequence

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
