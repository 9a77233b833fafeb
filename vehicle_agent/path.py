"""``Path``: one vehicle's own way through a route, as a dense curve with speeds and times."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vehicle_agent.route import Route

#: Distance in m of neighbouring points of a path.
SPACING: Final = 0.02

#: The curve goes on straight for this many m, so that a driver can look ahead of its end.
_RUN_OUT: Final = 2.0

_PIECES: Final = 40


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """A curve of D points ``SPACING`` apart.

    Attributes:
        start: first pose (x m, y m, yaw rad).
        points: (D, 2) m.
        elapsed: seconds (D,) from the first point at the speeds asked for.
        speeds: (D,) m/s.
        deadlines: (index of a point, when to be there in s since the start), in order.
        end: index of the last point before the run-out.
    """

    start: NDArray[np.float64]
    points: NDArray[np.float64]
    elapsed: NDArray[np.float64]
    speeds: NDArray[np.float64]
    deadlines: tuple[tuple[int, float], ...]
    end: int


def draw_path(route: Route, rng: np.random.Generator) -> Path:
    """A path of ``route``: start pose, way points and speeds varied by ``rng``.

    The curve is the quadratic B-spline of start and way points: each piece of it lies in the triangle of
    three neighbours. It touches the middle of each leg and passes a way point near by, where it turns.
    """
    start = np.array([rng.uniform(*route.start.x), rng.uniform(*route.start.y), rng.uniform(*route.start.yaw)])
    way = route.way_points
    jitter = np.array([point.jitter for point in way])
    points = np.array([(point.x, point.y) for point in way]) + jitter * rng.uniform(-1, 1, (len(way), 2))
    speeds = np.array([point.speed for point in way])
    speeds = speeds * (1 + route.speed_jitter * rng.uniform(-1, 1, len(way)))
    if route.mirror is not None and rng.random() < 0.5:
        start[0] = 2 * route.mirror - start[0]
        start[2] = np.pi - start[2]
        points[:, 0] = 2 * route.mirror - points[:, 0]
    curve, parameter = _spline(np.vstack((start[:2], points)))
    return _resample(start, curve, parameter, speeds, [point.at for point in way])


def _spline(control: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Quadratic B-spline of N ≥ 3 control points (N, 2), from the first to the last.

    Returns points (C, 2) and a parameter (C,) that increases along the curve and is i at control point i.
    """
    inner = control[1:-1]
    middles = (inner[1:] + inner[:-1]) / 2
    begins = np.vstack((control[:1], middles))[:, None]
    ends = np.vstack((middles, control[-1:]))[:, None]
    s = np.linspace(0, 1, _PIECES, endpoint=False)[:, None]
    pieces = (1 - s) ** 2 * begins + 2 * s * (1 - s) * inner[:, None] + s**2 * ends
    # The first and the last piece reach out to a control point where the others reach a middle.
    knots = np.arange(1.0, len(inner) + 1)
    first, last = knots - 0.5, knots + 0.5
    first[0], last[-1] = 0.0, len(inner) + 1.0
    along = np.where(s < 0.5, first + 2 * s * (knots - first), knots + (2 * s - 1) * (last - knots)).T
    return np.vstack((pieces.reshape(-1, 2), control[-1:])), np.append(along.ravel(), len(control) - 1.0)


def _resample(
    start: NDArray[np.float64],
    curve: NDArray[np.float64],
    along: NDArray[np.float64],
    speeds: NDArray[np.float64],
    times: list[float | None],
) -> Path:
    """Path through ``curve`` (C, 2) at even distances; ``along`` (C,) is i + 1 at way point i."""
    legs = np.hypot(*np.diff(curve, axis=0).T)
    curve, along = curve[np.append(True, legs > 0)], along[np.append(True, legs > 0)]
    length = np.append(0.0, np.cumsum(legs[legs > 0]))
    even = np.arange(0.0, length[-1], SPACING)
    inside = np.column_stack([np.interp(even, length, curve[:, axis]) for axis in (0, 1)])
    heading = (curve[-1] - curve[-2]) / legs[legs > 0][-1]
    run_out = curve[-1] + heading * np.arange(0.0, _RUN_OUT, SPACING)[:, None]
    points = np.vstack((inside, run_out))
    speed = np.interp(np.interp(even, length, along), np.arange(len(speeds)) + 1.0, speeds)
    speed = np.append(speed, np.full(len(run_out), speeds[-1]))
    passed = np.interp(np.arange(len(speeds)) + 1.0, along, length) / SPACING
    deadlines = tuple((round(passed[i]), at) for i, at in enumerate(times) if at is not None)
    elapsed = np.append(0.0, np.cumsum(SPACING / speed[:-1]))
    return Path(start, points, elapsed, speed, deadlines, len(even))
