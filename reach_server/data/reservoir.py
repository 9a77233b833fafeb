"""A few older transitions beside the newest ones, chosen to lie far apart."""

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.jit import kernel
from reach_server.numeric.slot_table import grow_rows
from reach_server.numeric.types import FloatArray, IntArray

#: Distances are measured anew in the scale that comes when it differs from theirs by more than this factor.
RESCALE = 2.0

#: Instead of the nearest row: the row offered lies too near to one.
REFUSED = -2


class Reservoir:
    """At most ``rows`` transitions of each of V vehicles: regressors ``z`` (V, R, p) and targets (V, R, n).

    Rows are offered one by one, as they leave the window. While there is room they are kept; then one takes the place
    of the row that lies nearest to another, if it lies farther from the rest than that. This greedily raises the least
    distance between two rows: a streaming form of farthest-point selection [Gon85], deterministic, O(R p) for a row.

    Distances are Euclidean in standardised coordinates; a coordinate whose scale is zero does not count.
    """

    def __init__(self, rows: int, regressors: int, targets: int) -> None:
        self.size = rows
        self.held = np.zeros(0, dtype=np.int64)  #: rows held (V,), the first ones of each vehicle
        self.z = np.zeros((0, rows, regressors))
        self.target = np.zeros((0, rows, targets))
        self.revision = np.zeros(0, dtype=np.int64)  #: rises (V,) whenever a row is taken
        self._scale = np.zeros((0, regressors))
        #: Squared distance of each row to its nearest neighbour, and which that is.
        self._gap = np.zeros((0, rows))
        self._nearest = np.zeros((0, rows), dtype=np.int64)

    def grow(self, slots: int) -> None:
        """Make room for ``slots`` vehicles."""
        for name in ("held", "z", "target", "revision", "_scale", "_gap", "_nearest"):
            array = getattr(self, name)
            setattr(self, name, grow_rows(array, slots, array))

    def clear(self, slot: int) -> None:
        """Forget the rows of one vehicle."""
        self.held[slot] = 0
        self.revision[slot] += 1

    def offer(self, slots: NDArray[np.intp], z: FloatArray, target: FloatArray, scale: FloatArray) -> None:
        """Offer a transition of each of the vehicles in ``slots`` (B,): regressors ``z`` (B, p) and ``target`` (B, n);
        ``scale`` (B, p) are the standard deviations of the regressors in their windows. Rows that are not finite are
        passed over."""
        if not self.size:
            return
        _offer(
            np.require(slots, np.int64, ("C", "W")), np.require(z, np.float64, ("C", "W")),
            np.require(target, np.float64, ("C", "W")), np.require(np.broadcast_to(scale, z.shape), None, ("C", "W")),
            self.held, self.z, self.target, self.revision, self._scale, self._gap, self._nearest,
        )  # fmt: skip

    def rows(self, slots: NDArray[np.intp]) -> tuple[FloatArray, FloatArray, IntArray]:
        """Regressors (B, R, p), targets (B, R, n) and how many of the rows are held (B,), of the vehicles in ``slots``
        (B,)."""
        return self.z[slots], self.target[slots], self.held[slots]


@kernel
def _offer(
    slots: IntArray,
    z: FloatArray,
    target: FloatArray,
    scale: FloatArray,
    held: IntArray,
    rows: FloatArray,
    targets: FloatArray,
    revision: IntArray,
    scales: FloatArray,
    gap: FloatArray,
    nearest: IntArray,
) -> None:
    size, p = rows.shape[1], rows.shape[2]
    distance, weight = np.empty(size), np.empty(p)
    for k in range(len(slots)):
        slot = slots[k]
        if not (np.isfinite(z[k]).all() and np.isfinite(target[k]).all()):
            continue
        own, count, gaps, neighbour = rows[slot], held[slot], gap[slot], nearest[slot]
        rescale = count == 0 or _differs(scales[slot], scale[k])
        for i in range(p):
            if rescale:
                scales[slot, i] = scale[k, i]
            weight[i] = 1.0 / scales[slot, i] ** 2 if scales[slot, i] > 0.0 else 0.0
        if rescale:
            for r in range(count):
                _find_nearest(own, count, r, weight, gaps, neighbour)
        index = int(np.argmin(gaps)) if count == size else int(count)
        closest = _distances(own, count, index, z[k], weight, gaps[index] if count == size else -1.0, distance)
        if closest == REFUSED:
            continue
        own[index], targets[slot, index] = z[k], target[k]
        held[slot] = count = max(count, index + 1)
        revision[slot] += 1
        gaps[index], neighbour[index] = np.inf if closest < 0 else distance[closest], closest
        for r in range(count):
            if r == index:
                continue
            if distance[r] < gaps[r]:
                gaps[r], neighbour[r] = distance[r], index
            elif neighbour[r] == index:
                _find_nearest(own, count, r, weight, gaps, neighbour)


@kernel
def _distances(
    own: FloatArray, count: int, index: int, z: FloatArray, weight: FloatArray, least: float, distance: FloatArray
) -> int:
    """Squared distances of z to all rows but that at ``index``; the nearest, -1 where there is none, and REFUSED as
    soon as one is not farther than ``least``."""
    closest = -1
    for r in range(count):
        if r == index:
            continue
        total = 0.0
        for i in range(len(z)):
            total += (own[r, i] - z[i]) ** 2 * weight[i]
        if total <= least:
            return REFUSED
        distance[r] = total
        if closest < 0 or total < distance[closest]:
            closest = r
    return REFUSED if closest < 0 and count > 0 else closest


@kernel
def _differs(before: FloatArray, now: FloatArray) -> bool:
    for i in range(len(now)):
        if (before[i] > 0.0) != (now[i] > 0.0) or now[i] > RESCALE * before[i] or before[i] > RESCALE * now[i]:
            return True
    return False


@kernel
def _find_nearest(
    own: FloatArray, count: int, r: int, weight: FloatArray, gaps: FloatArray, neighbour: IntArray
) -> None:
    """Set the squared distance of row r to its nearest neighbour, and which that is."""
    gaps[r], neighbour[r] = np.inf, -1
    for other in range(count):
        if other != r:
            total = 0.0
            for i in range(len(weight)):
                total += (own[r, i] - own[other, i]) ** 2 * weight[i]
            if total < gaps[r]:
                gaps[r], neighbour[r] = total, other
