"""The record of a vehicle class: what was predicted for each vehicle, how often it held, and what did not."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Audit
from reach_server.audit import Predictions
from reach_server.rows import with_room
from reach_server.windows import Floats, SampleBatch


@dataclass(frozen=True, slots=True)
class Miss:
    """A measured state that lay outside of its set by ``excess``; ``side_information``: but not of the uncut one."""

    slot: int
    t: int
    excess: float
    side_information: bool


class Record:
    """One-step predictions of the vehicles of a class, by slot."""

    def __init__(self) -> None:
        self.predictions = Predictions()
        self._checked = np.zeros(0, dtype=np.int64)
        self._inside = np.zeros(0, dtype=np.int64)
        self._last_miss = np.zeros(0)
        #: Whether a stated bound turned out to be wrong.
        self.falsified: NDArray[np.bool_] = np.zeros(0, dtype=bool)
        #: Stamps of samples that only side information excludes, by slot, until that has been looked into.
        self.doubted: dict[int, int] = {}

    def grow(self, slots: int) -> None:
        """Make room for ``slots`` vehicles."""
        for name in ("_checked", "_inside", "_last_miss", "falsified"):
            array = getattr(self, name)
            setattr(self, name, with_room(array, slots, array))

    def reset(self, slot: int) -> None:
        """Forget a vehicle."""
        self.predictions.drop(slot)
        self._checked[slot] = self._inside[slot] = self._last_miss[slot] = 0
        self.falsified[slot] = False
        self.doubted.pop(slot, None)

    def audit(self, slot: int) -> Audit:
        """Predictions of a vehicle that were checked, and how many held."""
        return Audit(int(self._checked[slot]), int(self._inside[slot]), float(self._last_miss[slot]))

    def check(self, batch: SampleBatch, slack: float, noise: Floats, angles: tuple[int, ...]) -> list[Miss]:
        """Hold the measurements against the predictions that wait for them; see ``Predictions.check``."""
        misses: list[Miss] = []
        for row, slot, held, excess, free_held in self.predictions.check(batch, slack, noise, angles):
            self._checked[slot] += 1
            self._inside[slot] += held
            if not held:
                self._last_miss[slot] = excess
                misses.append(Miss(slot, int(batch.t[row]), excess, free_held))
        return misses
