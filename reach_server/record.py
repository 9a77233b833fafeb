"""The record of a vehicle class: what was predicted for each vehicle, how often it held, and what did not."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Audit
from reach_server.audit import RECENT, Predictions, bands
from reach_server.rows import with_room
from reach_server.windows import Floats, SampleBatch


@dataclass(frozen=True, slots=True)
class Miss:
    """A measured state that lay outside of its set by ``excess``; ``side_information``: but not of the uncut one."""

    slot: int
    t: int
    excess: float
    side_information: bool


@dataclass(frozen=True, slots=True, eq=False)
class Checked:
    """What a batch of measurements says: ``misses``, and the slots whose rolling record ``left`` its band with them or
    ``returned`` into it."""

    misses: list[Miss]
    left: NDArray[np.intp]
    returned: NDArray[np.intp]


class Record:
    """One-step predictions of the vehicles of a class, by slot.

    A check misses with probability ``alpha`` at most, if the label is right. How many of the newest 1000 did is the
    rolling record, ``outside`` (V,) where that is more than ``alpha`` explains: see ``audit.bands``.
    """

    def __init__(self, alpha: float = 0.01) -> None:
        self.predictions = Predictions()
        self._leaves, self._returns = bands(alpha)
        self._checked = np.zeros(0, dtype=np.int64)
        self._inside = np.zeros(0, dtype=np.int64)
        self._last_miss = np.zeros(0)
        #: Which of the newest checks missed: a ring, the place of the next one is ``_checked % RECENT``.
        self._missed = np.zeros((0, RECENT), dtype=bool)
        self._misses = np.zeros(0, dtype=np.int64)
        self.outside: NDArray[np.bool_] = np.zeros(0, dtype=bool)
        #: Whether a stated bound turned out to be wrong.
        self.falsified: NDArray[np.bool_] = np.zeros(0, dtype=bool)
        #: Stamps of samples that only side information excludes, by slot, until that has been looked into.
        self.doubted: dict[int, int] = {}

    def grow(self, slots: int) -> None:
        """Make room for ``slots`` vehicles."""
        for name in ("_checked", "_inside", "_last_miss", "_missed", "_misses", "outside", "falsified"):
            array = getattr(self, name)
            setattr(self, name, with_room(array, slots, array))

    def reset(self, slot: int) -> None:
        """Forget a vehicle."""
        self.predictions.drop(slot)
        self._checked[slot] = self._inside[slot] = self._last_miss[slot] = self._misses[slot] = 0
        self._missed[slot] = False
        self.outside[slot] = self.falsified[slot] = False
        self.doubted.pop(slot, None)

    def audit(self, slot: int) -> Audit:
        """Predictions of a vehicle that were checked, and how many held."""
        checked = int(self._checked[slot])
        recent = min(checked, RECENT)
        return Audit(
            checked, int(self._inside[slot]), float(self._last_miss[slot]),
            recent, recent - int(self._misses[slot]), int(self._leaves[recent]),
        )  # fmt: skip

    def check(self, batch: SampleBatch, slack: float, noise: Floats, angles: tuple[int, ...]) -> Checked:
        """Hold the measurements against the predictions that wait for them; see ``Predictions.check``."""
        found = self.predictions.check(batch, slack, noise, angles)
        slots = found.slot
        missed = ~found.inside
        place = self._checked[slots] % RECENT
        self._misses[slots] += missed.astype(np.int64) - self._missed[slots, place]
        self._missed[slots, place] = missed
        self._checked[slots] += 1
        self._inside[slots] += found.inside
        left, returned = self._judge(slots)
        misses: list[Miss] = []
        for k in np.flatnonzero(missed).tolist():
            slot, excess = int(slots[k]), float(found.excess[k])
            self._last_miss[slot] = excess
            misses.append(Miss(slot, int(batch.t[found.row[k]]), excess, bool(found.inside_free[k])))
        return Checked(misses, left, returned)

    def _judge(self, slots: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The slots, of those checked, whose record leaves its band now, and those whose record returns."""
        recent = np.minimum(self._checked[slots], RECENT)
        outside, misses = self.outside[slots], self._misses[slots]
        left = slots[~outside & (misses > self._leaves[recent])]
        returned = slots[outside & (misses <= self._returns[recent])]
        self.outside[left] = True
        self.outside[returned] = False
        return left, returned
