"""What one step of the engine returns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Cut, EventKind, Label
from reach_server.factor_sets import FactorSet, join_sets
from reach_server.windows import Floats, Ints


@dataclass(frozen=True, slots=True)
class EngineEvent:
    """Something that happened to one vehicle in one step."""

    kind: EventKind
    vehicle: str
    t: int
    message: str
    details: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Tubes:
    """Tubes of B vehicles: ``steps`` holds the sets of steps 1 to N, ``free`` those without side information.

    ``area`` and ``area_free`` (B, N), ``outline`` (B, N, K, 2) and ``hull`` (B, N, 2, n) as in ``Figures``;
    ``labels``, ``methods``, ``cuts``, ``notes`` and ``verdicts`` one entry a vehicle; ``waiting`` says why other
    vehicles of the batch got no tube.
    """

    vehicles: tuple[str, ...]
    epoch: NDArray[np.uint64]
    seq: NDArray[np.uint64]
    t: Ints
    times: Ints
    steps: tuple[FactorSet, ...]
    free: tuple[FactorSet, ...]
    area: Floats
    area_free: Floats
    outline: Floats
    hull: Floats
    labels: tuple[Label, ...]
    methods: tuple[str, ...]
    cuts: tuple[tuple[Cut, ...], ...]
    notes: tuple[tuple[str, ...], ...]
    verdicts: tuple[Mapping[str, str], ...]
    events: tuple[EngineEvent, ...]
    waiting: dict[str, str]

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
