"""Which predicates made sets smaller, and over which steps, as tubes list them."""

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Cut
from reach_server.numeric.slot_table import distinct
from reach_server.predicates import Literals


def list_cuts(literals: Literals, active: NDArray[np.bool_]) -> tuple[tuple[Cut, ...], ...]:
    """For each vehicle the predicates that were active, from (B, N, L) over steps 1 to N."""
    owners = [(literals.scenario(i), literals.name(i)) for i in range(active.shape[2])]
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
    listed = [
        tuple(
            Cut(*predicate, *divmod(span, steps + 1)) for predicate, span in zip(predicates, way, strict=True) if span
        )
        for way in ways
    ]
    return tuple(listed[way] for way in which.tolist())
