"""Compiled: predictions and boxes, limited to how far a vehicle can get.

A state that has stated bounds ahead (``models.kinematic_bounds``) is held within these. One without is held within
``MARGIN`` times the greatest change from one sample to the next that the window shows, for every step: what it has
never done it may do, but not at once many times as fast.

Let y be a state within the bounds C, an interval for each state in the frame of the newest sample. The center c becomes
the point c' of C next to it, the box is cut by C about c'. Then ``|y_i - c'_i| <= |y_i - c_i|``, for c'_i is the
projection of c_i to an interval that holds y_i: so every y of C in the box before is in the box after, which is never
larger than C, nor empty.
"""

import math
from typing import NamedTuple

import numpy as np

from reach_server.data.observed_range import MARGIN
from reach_server.models.conformal.spec import FeatureSpec
from reach_server.numeric.jit import kernel
from reach_server.numeric.types import BoolArray, FloatArray


class Bounds(NamedTuple):
    """Stated bounds of states of B vehicles ahead: ``low`` and ``high`` (B, N, n) of each state, ``distance`` (B, N) of
    a pose from the one of now; infinite where nothing is stated. ``noisy``: they speak about true states, and how far
    measured ones are off is not stated: as far as the greatest change that was observed, times ``MARGIN``."""

    low: FloatArray
    high: FloatArray
    distance: FloatArray
    noisy: bool

    @classmethod
    def none(cls, vehicles: int, horizon: int, n: int) -> "Bounds":
        """Infinite bounds."""
        far = np.full((vehicles, horizon, n), np.inf)
        return cls(-far, far, far[:, :, 0].copy(), False)


@kernel
def bounds_of(
    bounds: Bounds,
    b: int,
    x: FloatArray,
    fastest: FloatArray,
    spec: FeatureSpec,
    low: FloatArray,
    high: FloatArray,
    stated: BoolArray,
) -> None:
    """Bounds ``low`` and ``high`` (N, n) of how far each state of a vehicle gets from ``x`` (n,), of positions of a
    pose along the frame of the newest sample; ``stated`` (n,) says of which they are stated, in both ways, at every
    step."""
    stated[:] = True
    for h in range(spec.horizon):
        for i in range(spec.n):
            slack = MARGIN * fastest[i]
            most = slack * (h + 1)
            beyond = slack if bounds.noisy else 0.0
            if spec.heading >= 0 and i in (spec.first, spec.second):
                least, greatest = -bounds.distance[b, h] - beyond, bounds.distance[b, h] + beyond
            else:
                least, greatest = bounds.low[b, h, i] - x[i] - beyond, bounds.high[b, h, i] - x[i] + beyond
            stated[i] = stated[i] and least > -math.inf and greatest < math.inf
            low[h, i] = least if least > -math.inf else -most
            high[h, i] = greatest if greatest < math.inf else most


@kernel
def _moved(center: FloatArray, x: FloatArray, cosine: float, sine: float, i: int, spec: FeatureSpec) -> float:
    """How far a predicted state (n,) is from ``x`` (n,) in state i, positions of a pose along the frame of x."""
    if spec.heading >= 0:
        ahead, left = center[spec.first] - x[spec.first], center[spec.second] - x[spec.second]
        if i == spec.first:
            return float(cosine * ahead + sine * left)
        if i == spec.second:
            return float(cosine * left - sine * ahead)
    return float(center[i] - x[i])


@kernel
def _shift(center: FloatArray, cosine: float, sine: float, i: int, by: float, spec: FeatureSpec) -> None:
    """Move a predicted state in state i, positions of a pose along the frame of the newest sample."""
    if spec.heading >= 0 and i == spec.first:
        center[spec.first] += cosine * by
        center[spec.second] += sine * by
    elif spec.heading >= 0 and i == spec.second:
        center[spec.first] -= sine * by
        center[spec.second] += cosine * by
    else:
        center[i] += by


@kernel
def hold_center(
    x: FloatArray, angle: float, low: FloatArray, high: FloatArray, spec: FeatureSpec, center: FloatArray
) -> None:
    """Move predictions ``center`` (N, n) into bounds (N, n) about ``x`` (n,); those within stay as they are."""
    c, s = math.cos(angle), math.sin(angle)
    for h in range(spec.horizon):
        for i in range(spec.n):
            moved = _moved(center[h], x, c, s, i, spec)
            if moved < low[h, i]:
                _shift(center[h], c, s, i, low[h, i] - moved, spec)
            elif moved > high[h, i]:
                _shift(center[h], c, s, i, high[h, i] - moved, spec)


@kernel
def hold(
    x: FloatArray,
    angle: float,
    low: FloatArray,
    high: FloatArray,
    stated: BoolArray,
    spec: FeatureSpec,
    center: FloatArray,
    half: FloatArray,
    held: BoolArray,
) -> None:
    """Cut boxes of centers (N, n) within bounds and half-widths ``half`` (N, n) by the bounds; those within stay as
    they are. ``held`` (2,) becomes true where stated bounds cut, and where observed ones do."""
    c, s = math.cos(angle), math.sin(angle)
    for h in range(spec.horizon):
        for i in range(spec.n):
            moved = _moved(center[h], x, c, s, i, spec)
            least, greatest = moved - half[h, i], moved + half[h, i]
            if least >= low[h, i] and greatest <= high[h, i]:
                continue
            least, greatest = max(least, low[h, i]), min(greatest, high[h, i])
            _shift(center[h], c, s, i, 0.5 * (least + greatest) - moved, spec)
            half[h, i] = 0.5 * (greatest - least)
            held[0 if stated[i] else 1] = True
