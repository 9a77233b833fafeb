"""A scenario of the paper laid over a recorded drive, so that the drive satisfies it with the least enlargement."""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import linprog

from fleet_lab.paper.drives import Track
from fleet_lab.paper.formulas import Disc, Formula, Motion, Strip, active
from reach_server.numeric.types import FloatArray

#: Rotations, and beginnings, that are tried.
_ROTATIONS, _STARTS = 36, 8
#: Windows are as long as in the paper, or these parts of it: the first at which a track can be made to satisfy them.
_STRETCHES: Final = (1.0, 0.75, 0.5, 0.35, 0.25, 0.18, 0.12, 0.08)
#: Regions are not made larger than this.
_LARGEST: Final = 6.0
#: Sides of the polygon inside a disc that stands for it: 0.5 % less than its radius.
_SIDES: Final = 32
#: m that every position keeps from the border of its region.
_CLEAR: Final = 1e-3
#: T(x) says nothing of use beyond this angle between its sides and the heading.
_WIDEST: Final = math.radians(80.0)


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """``x -> R(angle) x + shift`` takes recorded positions (m) into the frame of the scenario, whose regions are
    ``size`` times as large and whose windows are ``stretch`` times as long as in the paper; it begins with sample
    ``begin`` and has no part in those from ``end`` on."""

    angle: float
    shift: tuple[float, float]
    size: float
    stretch: float
    begin: int
    end: int

    def positions(self, position: FloatArray) -> FloatArray:
        """Positions (..., 2) in the frame of the scenario."""
        moved: FloatArray = position @ _rotation(self.angle).T + self.shift
        return moved

    def track(self, track: Track) -> Track:
        """The part of a track that takes part, in the frame and time of the scenario."""
        part = slice(self.begin, self.end)
        return Track(
            track.name,
            track.t[part] - track.t[self.begin],
            self.positions(track.position[part]),
            track.heading[part] + self.angle,
            track.velocity[part] @ _rotation(self.angle).T,
        )


def place(formula: Formula, track: Track) -> Placement | None:
    """The placement of least ``size``, at least 1, under which a track satisfies the strips and discs of ``formula``,
    with windows as long as that allows; None where there is none.

    For one rotation, beginning and length that is a linear program in shift and size: a strip asks for
    ``±(n (R x + shift) - middle size) <= radius size`` at the positions x of its window, of which those furthest along
    ±n decide; a disc is replaced by a polygon inside it, which asks for more.
    """
    length = float(track.t[-1] - track.t[0])
    for stretch in _STRETCHES:
        needed = stretch * formula.duration
        if needed > length:
            continue
        starts = np.unique(np.linspace(0.0, length - needed, _STARTS))
        found = [_placed(formula.laid_over(1.0, stretch), track, start, stretch) for start in starts.tolist()]
        feasible = [placement for placement in found if placement is not None]
        if feasible:
            return min(feasible, key=lambda placement: placement.size)
    return None


def _placed(timed: Formula, track: Track, start: float, stretch: float) -> Placement | None:
    begin = int(np.searchsorted(track.t - track.t[0], start))
    t = track.t - track.t[begin]
    taken = (t >= 0) & (t <= timed.duration)
    best: Placement | None = None
    for angle in (2 * np.pi * np.arange(_ROTATIONS) / _ROTATIONS).tolist():
        turned = track.position @ _rotation(angle).T
        rows = [row for part in timed.parts for row in _asked(part, turned[active(part, t) & taken])]
        found = linprog(
            [0.0, 0.0, 1.0], A_ub=np.array([row[:3] for row in rows]), b_ub=np.array([row[3] for row in rows]),
            bounds=[(None, None), (None, None), (1.0, _LARGEST)],
        )  # fmt: skip
        if found.x is not None and (best is None or found.x[2] < best.size):
            first, second, size = found.x.tolist()
            best = Placement(angle, (first, second), size, stretch, begin, begin + int(np.count_nonzero(taken)))
    return best


def widened_motion(motion: Motion, track: Track, unknown: FloatArray) -> Motion | None:
    """T(x) with the least angle, in whole degrees and at least the paper's, that a track never leaves; None where none
    below 80° does. ``unknown`` (2, g) bounds the error of the corner."""
    moved = np.diff(track.position, axis=0)
    for degrees in range(round(math.degrees(motion.turn)), round(math.degrees(_WIDEST)) + 1):
        wider = replace(motion, turn=math.radians(degrees))
        if all(_within(wider, side, track.heading[:-1], moved, unknown) for side in (1.0, -1.0)):
            return wider
    return None


def _within(motion: Motion, side: float, heading: FloatArray, moved: FloatArray, unknown: FloatArray) -> bool:
    direction = heading + side * motion.turn
    left = np.column_stack([-np.sin(direction), np.cos(direction)])
    ahead, blurred = -side * (left * moved).sum(axis=1), np.abs(left @ unknown).sum(axis=1)
    return bool(((ahead >= -blurred) & (ahead <= motion.height + blurred)).all())


def _asked(part: Strip | Disc, position: FloatArray) -> list[tuple[float, float, float, float]]:
    """Rows (shift, shift, size, bound) of the linear program for the positions (K, 2) of a part's window."""
    if not len(position):
        return []
    if isinstance(part, Strip):
        directions = [(np.array(part.normal) * sign, part.middle * sign + part.radius) for sign in (1.0, -1.0)]
    else:
        angles = 2 * np.pi * np.arange(_SIDES) / _SIDES
        normals = np.column_stack([np.cos(angles), np.sin(angles)])
        inner = part.radius * math.cos(math.pi / _SIDES)
        directions = [(normal, float(normal @ part.center) + inner) for normal in normals]
    return [
        (float(normal[0]), float(normal[1]), -reach, -float((position @ normal).max()) - _CLEAR)
        for normal, reach in directions
    ]


def _rotation(angle: float) -> FloatArray:
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])
