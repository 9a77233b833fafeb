"""Reachable sets of vehicles whose scenarios may branch or ask for predicates that depend on the set, step by step."""

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import VehicleProfile
from reach_server.numeric.slot_table import take_rows
from reach_server.predicates.cut_kinds import CUT_KINDS
from reach_server.sets.raw import RawSets
from reach_server.side_information.scenarios import Assignments, InitialConditions
from reach_server.tube.branching import Hypotheses, Motion, SideInformation, Tube, propagate
from reach_server.tube.reach_sets import ReachSets
from reach_server.tube.summaries import PlaneStrips, of_tracks, where_smaller
from side_info.progression import TRUE


def branching(
    motion: Motion,
    start: RawSets,
    rows: NDArray[np.intp],
    asked: tuple[NDArray[np.intp], NDArray[np.int64], NDArray[np.bool_]],
    initial: InitialConditions,
    side: Assignments,
    profile: VehicleProfile,
) -> ReachSets:
    """The sets of the vehicles of some ``rows`` (K,), ascending, out of B that begin in ``start`` (B, n).

    ``asked``: the row (R,) of one of these vehicles, ascending, an obligation (R,) that it may have from now on, and of
    which of all vehicles (B,) the newest sample may be cut. Every vehicle has a track that asks for nothing, and one
    more where a scenario asks for something.
    """
    row, obligation, tested = asked
    n, count = start.center.shape[1], len(rows)
    index = np.searchsorted(rows, row)
    with_side = np.unique(index)
    vehicle = rows[np.concatenate([np.arange(count), with_side])]
    track = np.concatenate([np.arange(count), count + np.searchsorted(with_side, index)])
    everything = np.concatenate([np.full(count, TRUE, dtype=np.int64), obligation])
    own = np.concatenate([np.arange(count), with_side])
    tracks = Hypotheses(vehicle, take_rows(start, vehicle), track, everything, tested[vehicle], own)
    contexts = side.contexts(initial)
    knowledge = SideInformation(
        side.table, side.literals, lambda k, which: contexts(k, vehicle[which]), profile.cuts, side.plane
    )
    tube = propagate(tracks, motion, knowledge, n)
    whole = tube.ended[count:] < 0
    cut, improved = count + np.flatnonzero(whole), with_side[whole]
    active = np.flatnonzero(tube.active.any(axis=(0, 1))).tolist()
    strips = PlaneStrips.of(side.literals, active, n, profile.position)
    free = [of_tracks(step, np.arange(count), strips, profile.position) for step in tube.steps[1:]]
    # The paper's cuts are shown as they are, larger or not.
    always = CUT_KINDS[profile.cuts].keeps_larger_result
    found = [
        where_smaller(uncut, of_tracks(step, cut, strips, profile.position), improved, always=always)
        if len(improved)
        else uncut
        for step, uncut in zip(tube.steps[1:], free, strict=True)
    ]
    chosen = np.arange(count)
    chosen[improved] = cut
    emptied = np.zeros(count, dtype=bool)
    emptied[with_side[~whole]] = True
    steps = tuple(sets for sets, _ in found)
    return ReachSets(
        steps, tuple(sets for sets, _ in free),
        np.stack([f.area for _, f in found], axis=1), np.stack([f.area for _, f in free], axis=1),
        np.stack([f.heights for _, f in found], axis=1), np.stack([f.hull for _, f in found], axis=1),
        tube.active[chosen, 1:], _bounded(steps), emptied, tube.contradicted[:count], _responsible(tube, own, side),
    )  # fmt: skip


def _bounded(steps: tuple[RawSets, ...]) -> NDArray[np.bool_]:
    """Which vehicles (B,) have finite sets only."""
    finite = [np.isfinite(s.center).all(axis=1) & np.isfinite(s.generators).all(axis=(1, 2)) for s in steps]
    return np.asarray(np.all(finite, axis=0))


def _responsible(tube: Tube, own: NDArray[np.intp], side: Assignments) -> dict[int, tuple[int, list[int]]]:
    """By vehicle, ``own`` (T,) of the tracks: the step at which the last branch was empty, and the literals that took
    part."""
    responsible = {}
    for track in np.flatnonzero(tube.ended >= 0).tolist():
        # What cut before may be as wrong as what left nothing: all scenarios that took part are named.
        before = tube.active[track].any(axis=0)
        literals = np.flatnonzero(tube.responsible[track] | side.of_others(before, tube.responsible[track])).tolist()
        responsible[int(own[track])] = int(tube.ended[track]), literals
    return responsible
