"""Ranges of the states and inputs in the data of a window, and which values lie outside them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reach_server.data.regressors import Transitions
from reach_server.numeric.jit import kernel
from reach_server.numeric.types import BoolArray, FloatArray

#: Units of what enters a model are at least this part of 1 + its magnitude: what does not vary would have none.
LEAST_UNIT = 1e-6
#: A value is outside the data where fewer than so many data lie as far out,
ENOUGH = 10
#: or, of a short window, this part of the data,
ENOUGH_PART = 0.01
#: and it is more than this part of the range of the others beyond them.
BEYOND = 0.25
#: Of what has no range of its own, rates and products: so many standard deviations from the mean of the data.
FAR = 5.0
#: Times the greatest change that was observed that a state without stated bounds may change in one step.
MARGIN = 4.0


@kernel
def range_of(values: FloatArray, used: BoolArray) -> tuple[float, float]:
    """The ``used`` (S,) ones of some values (S,), least and greatest, without those that are not enough: see
    ``ENOUGH``. Infinite, the wrong way round, where none is used."""
    count = 0
    for k in range(len(values)):
        count += int(used[k])
    wanted = max(min(ENOUGH, int(ENOUGH_PART * count)), 1)
    # Ascending: the greatest ones, and the negatives of the least ones.
    top, bottom = np.full(wanted, -np.inf), np.full(wanted, -np.inf)
    for k in range(len(values)):
        if not used[k]:
            continue
        for side in range(2):
            kept, value = (top, values[k]) if side == 0 else (bottom, -values[k])
            if value > kept[0]:
                i = 1
                while i < wanted and kept[i] < value:
                    kept[i - 1] = kept[i]
                    i += 1
                kept[i - 1] = value
    return float(-bottom[0]), float(top[0])


@kernel
def outside(value: float, low: float, high: float) -> bool:
    """Whether a value lies outside the data of which this is the range. What is no number does."""
    slack = BEYOND * (high - low) + LEAST_UNIT * (1.0 + max(abs(low), abs(high)))
    return not low - slack <= value <= high + slack


@kernel
def ranges_many(slots: NDArray[np.int64], z: FloatArray, valid: BoolArray, low: FloatArray, high: FloatArray) -> None:
    """Ranges ``low`` and ``high`` (V, p) of the ``valid`` (V, S) data z (V, p, S) of some vehicles."""
    for slot in slots:
        for c in range(z.shape[1]):
            low[slot, c], high[slot, c] = range_of(z[slot, c], valid[slot])


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Ranges ``low`` and ``high`` (V, p) of the regressors of the data of vehicles."""

    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, data: Transitions) -> "Seen":
        """Ranges of the regressors of transitions."""
        vehicles, _, p = data.z.shape
        seen = cls(np.empty((vehicles, p)), np.empty((vehicles, p)))
        z = np.ascontiguousarray(np.swapaxes(data.z, 1, 2))
        ranges_many(np.arange(vehicles), z, data.usable, seen.low, seen.high)
        return seen

    def outside(self, z: FloatArray) -> NDArray[np.bool_]:
        """Which regressors ``z`` (V, p) are outside the data."""
        slack = BEYOND * (self.high - self.low)
        slack += LEAST_UNIT * (1.0 + np.maximum(np.abs(self.low), np.abs(self.high)))
        return np.asarray(~((z >= self.low - slack) & (z <= self.high + slack)))
