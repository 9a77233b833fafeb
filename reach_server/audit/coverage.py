"""The coverage record of a vehicle class: how often its one-step predictions held, and whether that agrees with its
label."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Audit
from reach_server.audit.prediction_check import RECENT, Predictions, bands
from reach_server.data.window import SampleBatch
from reach_server.numeric.slot_table import grow_rows, take_rows
from reach_server.numeric.types import FloatArray

#: A jump that a bound, wrong by this factor at most, explains is none: it is held against the bound.
BEYOND_BOUNDS = 5.0
#: Jumps among ``RECENT`` checks that cost no label: one bad pose makes two, there and back.
FORGIVEN = 2
#: Times that the span, after which a refuted bound is believed again, is doubled at most.
MOST_DOUBLINGS = 20


@dataclass(frozen=True, slots=True)
class Miss:
    """A measured state that lay outside of its set by ``excess``; ``side_information``: but not of the uncut one."""

    slot: int
    t: int
    excess: float
    side_information: bool


@dataclass(frozen=True, slots=True, eq=False)
class Checked:
    """The result of checking a batch of measurements: ``misses``; the slots whose rolling record ``left`` its band with
    them or ``returned`` into it; and those whose refuted bounds have held for long enough since, ``restored``."""

    misses: list[Miss]
    left: NDArray[np.intp]
    returned: NDArray[np.intp]
    restored: NDArray[np.intp]


class CoverageRecord:
    """One-step predictions of the vehicles of a class, by slot.

    A check misses with probability ``alpha`` at most, if the label is right. How many of the newest 1000 missed is the
    rolling record, ``outside`` (V,) where that is more than ``alpha`` explains: see ``prediction_check.bands``.

    Where ``alpha`` is 0 the sets rest on stated bounds, and these are judged:

    ====================  ==============================================================================================
    miss                  refutes a bound: ``refuted``, see ``refute``
    miss of a jump        no check at all: a pose that the window takes for a jump, and that lies more than
                          ``BEYOND_BOUNDS`` times as far from the center of the set without cuts as the set reaches
    jumps                 more than ``FORGIVEN`` of them within ``RECENT`` checks: ``restless``
    checks that hold      ``span`` of them in a row after the last refutation end ``refuted``; twice as many after the
                          second time, and so on
    ====================  ==============================================================================================
    """

    def __init__(self, alpha: float = 0.01, span: int = RECENT) -> None:
        self.predictions = Predictions()
        self.alpha = alpha
        #: Predictions that were checked, of all vehicles, those forgotten since among them; and how many of them held.
        self.checked_so_far = self.inside_so_far = 0
        self._judges_bounds = alpha == 0.0
        self._span = span
        self._leaves, self._returns = bands(alpha)
        self._checked = np.zeros(0, dtype=np.int64)
        self._inside = np.zeros(0, dtype=np.int64)
        self._last_miss = np.zeros(0)
        #: Which of the newest checks missed: a ring, the place of the next one is ``_checked % RECENT``.
        self._missed = np.zeros((0, RECENT), dtype=bool)
        self._misses = np.zeros(0, dtype=np.int64)
        self.outside: NDArray[np.bool_] = np.zeros(0, dtype=bool)
        #: Whether a stated bound turned out to be wrong, how often that was found, and checks that held since.
        self.refuted: NDArray[np.bool_] = np.zeros(0, dtype=bool)
        self._refutations = np.zeros(0, dtype=np.int64)
        self._held = np.zeros(0, dtype=np.int64)
        #: How many had been checked, plus one, at the newest jumps, oldest first; 0 for none.
        self._jumps = np.zeros((0, FORGIVEN + 1), dtype=np.int64)
        #: Stamps of samples that only side information excludes, by slot, until that has been looked into.
        self.unexplained: dict[int, int] = {}

    def grow(self, slots: int) -> None:
        """Make room for ``slots`` vehicles."""
        for name in (
            "_checked", "_inside", "_last_miss", "_missed", "_misses", "outside", "refuted", "_refutations", "_held",
            "_jumps",
        ):  # fmt: skip
            array = getattr(self, name)
            setattr(self, name, grow_rows(array, slots, array))

    def reset(self, slot: int) -> None:
        """Forget a vehicle."""
        self.predictions.drop(slot)
        self._checked[slot] = self._inside[slot] = self._last_miss[slot] = self._misses[slot] = 0
        self._missed[slot] = False
        self._refutations[slot] = self._held[slot] = self._jumps[slot] = 0
        self.outside[slot] = self.refuted[slot] = False
        self.unexplained.pop(slot, None)

    def audit(self, slot: int) -> Audit:
        """Predictions of a vehicle that were checked, and how many held."""
        checked = int(self._checked[slot])
        recent = min(checked, RECENT)
        return Audit(
            checked, int(self._inside[slot]), float(self._last_miss[slot]),
            recent, recent - int(self._misses[slot]), int(self._leaves[recent]),
        )  # fmt: skip

    def refute(self, slot: int) -> bool:
        """A stated bound of a vehicle turned out to be wrong, by a miss or by the data; whether that is news."""
        news = not self.refuted[slot]
        self._refutations[slot] += news
        self._held[slot] = 0
        self.refuted[slot] = True
        return news

    def jumped(self, slot: int) -> bool:
        """The pose of a vehicle jumped; whether it does so too often for its label."""
        self._jumps[slot, :-1] = self._jumps[slot, 1:]
        self._jumps[slot, -1] = self._checked[slot] + 1
        return bool(self.restless(np.array([slot]))[0])

    def restless(self, slots: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Which vehicles (B,) jump too often for a label that rests on bounds."""
        oldest = self._jumps[slots, 0]
        return np.asarray((oldest > 0) & (self._checked[slots] + 1 - oldest < RECENT) & self._judges_bounds)

    def check(
        self, batch: SampleBatch, slack: float, noise: FloatArray, angles: tuple[int, ...], jumped: NDArray[np.bool_]
    ) -> Checked:
        """Check pending predictions against measurements, see ``Predictions.check``; ``jumped`` (B,) are those whose
        pose jumped."""
        found = self.predictions.check(batch, slack, noise, angles)
        if self._judges_bounds and jumped[found.row].any():
            no_check = jumped[found.row] & ~found.inside & (found.times_free > BEYOND_BOUNDS)
            for slot in found.slot[no_check].tolist():
                # Nor is the received state cut by what was predicted for it.
                self.predictions.drop(slot)
            found = take_rows(found, ~no_check)
        slots = found.slot
        missed = ~found.inside
        index = self._checked[slots] % RECENT
        self._misses[slots] += missed.astype(np.int64) - self._missed[slots, index]
        self._missed[slots, index] = missed
        self._checked[slots] += 1
        self._inside[slots] += found.inside
        self.checked_so_far += len(slots)
        self.inside_so_far += int(found.inside.sum())
        left, returned = self._judge(slots)
        # What only side information excludes says nothing against the bounds.
        self._held[slots] = np.where(found.inside_free, self._held[slots] + 1, 0)
        enough = self._span << np.minimum(np.maximum(self._refutations[slots] - 1, 0), MOST_DOUBLINGS)
        restored = slots[self.refuted[slots] & (self._held[slots] >= enough)]
        self.refuted[restored] = False
        misses: list[Miss] = []
        for k in np.flatnonzero(missed).tolist():
            slot, excess = int(slots[k]), float(found.excess[k])
            self._last_miss[slot] = excess
            misses.append(Miss(slot, int(batch.t[found.row[k]]), excess, bool(found.inside_free[k])))
        return Checked(misses, left, returned, restored)

    def _judge(self, slots: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The slots, of those checked, whose record leaves its band now, and those whose record returns."""
        recent = np.minimum(self._checked[slots], RECENT)
        outside, misses = self.outside[slots], self._misses[slots]
        left = slots[~outside & (misses > self._leaves[recent])]
        returned = slots[outside & (misses <= self._returns[recent])]
        self.outside[left] = True
        self.outside[returned] = False
        return left, returned
