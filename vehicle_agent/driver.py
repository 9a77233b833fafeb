"""A pure-pursuit driver that follows a path and is where it must be in time."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vehicle_agent.path import SPACING, Path
from vehicle_agent.svea import SveaParameters, limit_command

#: m, and s of the present speed.
LOOK_AHEAD: Final = (0.22, 0.28)

#: Speeds in m/s that a driver under time pressure asks for.
SPEEDS: Final = (0.3, 1.2)

#: How much faster or slower than asked for a driver goes to be in time.
HASTE: Final = (0.5, 2.0)

_SEARCH: Final = round(0.6 / SPACING)

# Below this many seconds to a deadline the ratio of times says more about noise than about haste.
_NO_HURRY: Final = 0.3


class Driver:
    """Follows ``path`` from its start; every command obeys the car's limits and rates.

    Steering (Coulter 1992): the arc from the car to the point of the path at the look-ahead distance l has
    curvature 2 sin(alpha)/l, alpha being the direction to that point. Speed: what the path asks for, times
    the ratio of the time the path takes to the next deadline to the time that is left.
    """

    def __init__(self, parameters: SveaParameters, path: Path) -> None:
        self._parameters = parameters
        self._path = path
        self._at = 0
        self._haste = 1.0
        self._command = np.zeros(2)

    def command(self, t: float, measured: NDArray[np.float64]) -> NDArray[np.float64]:
        """Command (steering rad, velocity m/s) for the state ``measured`` (4) at ``t`` s since the start."""
        x, y, yaw, v = measured.tolist()
        path, points = self._path, self._path.points
        near = points[self._at : self._at + _SEARCH]
        self._at += int(np.argmin((near[:, 0] - x) ** 2 + (near[:, 1] - y) ** 2))
        ahead = self._at + round((LOOK_AHEAD[0] + LOOK_AHEAD[1] * abs(v)) / SPACING)
        to_x, to_y = (points[min(ahead, len(points) - 1)] - (x, y)).tolist()
        distance = max(math.hypot(to_x, to_y), SPACING)
        curvature = 2 * math.sin(math.atan2(to_y, to_x) - yaw) / distance
        steering = math.atan(self._parameters.wheel_base * curvature)
        wanted = np.array([steering, self._speed(t) if self._at < path.end else 0.0])
        self._command = limit_command(self._parameters, wanted, self._command)
        return self._command

    def _speed(self, t: float) -> float:
        path = self._path
        index, at = next(((i, at) for i, at in path.deadlines if i > self._at), (0, t))
        if not index:
            self._haste = 1.0
        elif at - t > _NO_HURRY:
            ratio = float(path.elapsed[index] - path.elapsed[self._at]) / (at - t)
            self._haste = min(max(ratio, HASTE[0]), HASTE[1])
        return min(max(float(path.speeds[self._at]) * self._haste, SPEEDS[0]), SPEEDS[1])
