"""What one step of the engine returns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Cut, Label
from reach_server.data.events import EngineEvent
from reach_server.numeric.types import FloatArray, IntArray
from reach_server.sets.raw import RawSets, join_sets


@dataclass(frozen=True, slots=True)
class Checks:
    """One-step predictions of a class that were ``checked``, how many were ``inside`` of their sets, and the greatest
    number of misses that the claim of the class lets expect; all of them only grow."""

    checked: int = 0
    inside: int = 0
    expected_misses: float = 0.0

    def __add__(self, other: "Checks") -> "Checks":
        return Checks(
            self.checked + other.checked, self.inside + other.inside, self.expected_misses + other.expected_misses
        )

    def __sub__(self, other: "Checks") -> "Checks":
        return Checks(
            self.checked - other.checked, self.inside - other.inside, self.expected_misses - other.expected_misses
        )


@dataclass(frozen=True, slots=True, eq=False)
class Tubes:
    """Tubes of B vehicles, each over N steps: what ``labels`` says of a vehicle is claimed of its sets.

    Attributes:
        vehicles: ids.
        epoch, seq: (B,) which sample a tube starts from.
        t: (B,) stamp of that sample, ns.
        times: (B, N) of the sets, ns.
        steps: sets of steps 1 to N, each of all B vehicles; constrained ones with ``cuts: constrained``.
        free: the same without side information.
        area: (B, N) of the position sets, cut once more by the predicates on the position that acted, in the squared
            unit of the position: exact of zonotopes, outer of constrained ones.
        area_free: (B, N) the same without side information.
        outline: (B, N, K, 2) vertices of a polygon around these position sets, counter-clockwise, relative to the
            center of the step: outer.
        hull: (B, N, 2, n) least and greatest value of each state, relative to the center of the step: outer.
        labels, methods, cuts, notes, verdicts: one entry a vehicle.
        events: what happened in this step, to any vehicle of the batch.
        waiting: by id, why other vehicles of the batch got no tube.
    """

    vehicles: tuple[str, ...]
    epoch: NDArray[np.uint64]
    seq: NDArray[np.uint64]
    t: IntArray
    times: IntArray
    steps: tuple[RawSets, ...]
    free: tuple[RawSets, ...]
    area: FloatArray
    area_free: FloatArray
    outline: FloatArray
    hull: FloatArray
    labels: tuple[Label, ...]
    methods: tuple[str, ...]
    cuts: tuple[tuple[Cut, ...], ...]
    notes: tuple[tuple[str, ...], ...]
    verdicts: tuple[Mapping[str, str], ...]
    events: tuple[EngineEvent, ...]
    waiting: dict[str, str]

    def noted(self, notes: Mapping[str, str], *, contradicted: bool = False) -> "Tubes":
        """The same tubes with one more note to each of the vehicles in ``notes``; their labels ``contradicted`` too."""
        if notes.keys().isdisjoint(self.vehicles):
            return self
        every = [(*own, notes[v]) if v in notes else own for v, own in zip(self.vehicles, self.notes, strict=True)]
        labels = [
            Label.CONTRADICTED if contradicted and v in notes else label
            for v, label in zip(self.vehicles, self.labels, strict=True)
        ]
        return replace(self, notes=tuple(every), labels=tuple(labels))

    @staticmethod
    def together(parts: Sequence["Tubes"]) -> "Tubes":
        """The tubes of several parts of a batch, one part after the other."""
        joined: list[Any] = []
        for f in fields(Tubes):
            values = [getattr(part, f.name) for part in parts]
            if f.name in ("steps", "free"):
                joined.append(tuple(join_sets(list(sets)) for sets in zip(*values, strict=True)))
            elif f.name == "waiting":
                joined.append({name: why for value in values for name, why in value.items()})
            elif isinstance(values[0], tuple):
                joined.append(tuple(one for value in values for one in value))
            else:
                joined.append(np.concatenate(values))
        return Tubes(*joined)
