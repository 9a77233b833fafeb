"""From the engine's tubes to the messages that are published: constant size, rounded outwards."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import accumulate, islice
from typing import Final

import numpy as np

from fleet_bus.messages import Audit, Cut, ReachTube
from reach_server.engine.engine import Engine
from reach_server.engine.results import Tubes
from reach_server.numeric.types import FloatArray
from reach_server.tube import summaries as figures

#: Bytes that the cuts of a tube may take, and those of its verdicts: ``VehicleProfile.tube_bytes`` has room for both.
LONGEST_LIST: Final = 3072
#: Bytes of one of them beside its texts, at most.
ROW: Final = 16
CUTS_LEFT_OUT: Final = "more predicates made sets smaller than are listed"
VERDICTS_LEFT_OUT: Final = "more requirements have a verdict than are listed"


def of_round(
    tubes: Sequence[tuple[Engine, Tubes]], note: str | None, *, server: str, server_epoch: int, compute_seconds: float
) -> Iterator[ReachTube]:
    """The messages of all tubes of a round, in order; ``note``: what each of them has to say of the server's load."""
    for engine, found in tubes:
        audits = [engine.audit_of(vehicle) for vehicle in found.vehicles]
        noted = found if note is None else found.noted(dict.fromkeys(found.vehicles, note))
        profile = engine.profile
        yield from messages(
            noted, profile.state_names, profile.position, audits,
            server=server, server_epoch=server_epoch, compute_seconds=compute_seconds,
        )  # fmt: skip


def messages(
    tubes: Tubes,
    state_names: tuple[str, ...],
    plane: tuple[int, int],
    audits: list[Audit],
    *,
    server: str,
    server_epoch: int,
    compute_seconds: float,
) -> Iterator[ReachTube]:
    """One ``ReachTube`` per vehicle; every set in it contains the engine's, float32 rounding included."""
    if not tubes.vehicles:
        return
    center = np.stack([s.center for s in tubes.steps], axis=1)
    generators = np.stack([outward_generators(figures.enclosing(s)) for s in tubes.steps], axis=1)
    hull = outward_box(tubes.hull)
    for i, vehicle in enumerate(tubes.vehicles):
        cuts, verdicts, notes = _listed(tubes.cuts[i], tubes.verdicts[i], tubes.notes[i])
        yield ReachTube(
            vehicle, int(tubes.epoch[i]), int(tubes.seq[i]), int(tubes.t[i]), tubes.times[i], state_names, plane,
            tubes.methods[i], tubes.labels[i], center[i], generators[i], hull[i], tubes.outline[i], tubes.area[i],
            tubes.area_free[i], cuts, notes, verdicts, audits[i], server, server_epoch, compute_seconds,
        )  # fmt: skip


def _listed(
    cuts: tuple[Cut, ...], verdicts: Mapping[str, str], notes: tuple[str, ...]
) -> tuple[tuple[Cut, ...], Mapping[str, str], tuple[str, ...]]:
    """The first of the cuts and verdicts that a message has room for, and a note if these are not all."""
    texts = [len(cut.scenario) + len(cut.predicate) for cut in cuts]
    rows = [len(name) + len(text) for name, text in verdicts.items()]
    if sum(texts) + sum(rows) + ROW * (len(texts) + len(rows)) <= LONGEST_LIST:
        return cuts, verdicts, notes
    kept, told = (sum(used <= LONGEST_LIST for used in accumulate(n + ROW for n in each)) for each in (texts, rows))
    lists = [(kept < len(cuts), CUTS_LEFT_OUT), (told < len(verdicts), VERDICTS_LEFT_OUT)]
    more = tuple(note for short, note in lists if short)
    return cuts[:kept], dict(islice(verdicts.items(), told)), notes + more


def outward_generators(generators: FloatArray) -> FloatArray:
    """Generators (..., n, g) representable in float32 of a zonotope around the one given.

    What the rounding takes from a row is given back to that row's diagonal generator (the last n columns).
    """
    n = generators.shape[-2]
    rounded = generators.astype(np.float32).astype(np.float64)
    lost = np.abs(generators - rounded).sum(axis=-1)
    diagonal = np.arange(n)
    exact = generators[..., diagonal, generators.shape[-1] - n + diagonal]
    rounded[..., diagonal, generators.shape[-1] - n + diagonal] = _up(exact + lost)
    return np.asarray(rounded)


def outward_box(bounds: FloatArray) -> FloatArray:
    """Lower and upper bounds (..., 2, n) representable in float32, not inside of those given."""
    return np.stack([-_up(-bounds[..., 0, :]), _up(bounds[..., 1, :])], axis=-2)


def _up(value: FloatArray) -> FloatArray:
    """The next number representable in float32 that is not below."""
    rounded = value.astype(np.float32)
    return np.where(rounded < value, np.nextafter(rounded, np.float32(np.inf)), rounded).astype(np.float64)
