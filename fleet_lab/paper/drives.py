"""Seeded drives of the simulated SVEA at 100 Hz that satisfy the paper's formulas, and the data it has from before.

The paper's recordings are not public. Its unconstrained area shows what they were like: residuals of about 0.14 mm,
which takes some 100 Hz and an input that carries the displacement. So the state is the position, and the input the
velocity vector in force.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Final

import numpy as np

from fleet_bus.errors import UsageError
from fleet_lab.paper.formulas import Formula
from reach_server.numeric.types import FloatArray
from vehicle_agent.driver import Driver
from vehicle_agent.path import draw_path
from vehicle_agent.route import Route, load_route
from vehicle_agent.simulate import Car, simulate_history
from vehicle_agent.svea import SveaParameters

SAMPLE_TIME: Final = 0.01
#: Trajectories of the data, and transitions of each.
RUNS, TRANSITIONS = 4, 250
#: m/s: T(x) has its corner at the vehicle, and one that stands leaves it by the least shift.
ROLLING: Final = 0.3
#: The car: what it does in a sample is disturbed in its heading only, so that it never moves backwards.
CAR: Final = SveaParameters(
    dt=SAMPLE_TIME, steering_delay=10, process_noise=(0.0, 0.0, 0.0005, 0.0), sensor_noise=(0.0, 0.0, 0.0, 0.0)
)
_TRIES: Final = 400


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """K + 1 samples of a drive.

    Attributes:
        name: what to call it.
        t: seconds since the start (K + 1,).
        position: (K + 1, 2) m.
        heading: (K + 1,) rad.
        velocity: (K + 1, 2) m/s, the input in force from each sample on.
    """

    name: str
    t: FloatArray
    position: FloatArray
    heading: FloatArray
    velocity: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Data:
    """Transitions of earlier drives: positions ``x`` (T, 2), inputs ``u`` (T, 2), next positions ``after`` (T, 2)."""

    x: FloatArray
    u: FloatArray
    after: FloatArray

    @staticmethod
    def of(tracks: Sequence[Track]) -> "Data":
        """The transitions of some tracks."""
        return Data(
            np.concatenate([track.position[:-1] for track in tracks]),
            np.concatenate([track.velocity[:-1] for track in tracks]),
            np.concatenate([track.position[1:] for track in tracks]),
        )


def history(seed: int) -> list[Track]:
    """``RUNS`` free drives of ``TRANSITIONS`` transitions each."""
    # The first second is left out: the car starts at rest, which is not where data is informative.
    drives = [simulate_history(seed * RUNS + run, TRANSITIONS + 201, CAR) for run in range(RUNS)]
    return [_track(f"history {run}", drive.truth[100 : 101 + TRANSITIONS]) for run, drive in enumerate(drives)]


def simulate(formula: Formula, seed: int, route: Route | None = None) -> Track:
    """A drive that satisfies ``formula``, by default on a route of this package; raises ``UsageError`` where none of
    many variations does."""
    if route is None:
        with resources.as_file(resources.files("fleet_lab.paper") / "routes") as folder:
            route = load_route(folder / ("ring.yaml" if formula.discs else "lot.yaml"))
    t = SAMPLE_TIME * np.arange(round(formula.duration / SAMPLE_TIME) + 1.0)
    for attempt in range(_TRIES):
        rng = np.random.default_rng([seed, attempt])
        path = draw_path(route, rng)
        driver, car = Driver(CAR, path), Car(CAR, np.append(path.start, ROLLING), rng)
        truth = np.empty((len(t), 4))
        for k in range(len(t)):
            truth[k] = car.state
            car.advance(driver.command(t[k], truth[k]))
            if k % 50 == 0 and (formula.clearance(t[k : k + 1], truth[k : k + 1, :2]) < 0).any():
                break
        else:
            track = _track(f"drive {seed}", truth)
            if satisfies(formula, track):
                return track
    raise UsageError(f"none of {_TRIES} simulated drives of seed {seed} satisfies {formula.symbol}")


def satisfies(formula: Formula, track: Track) -> bool:
    """Whether a track obeys the strips and discs at all its samples, and T(x) at every step."""
    if (formula.clearance(track.t, track.position) < 0).any():
        return False
    if formula.motion is None:
        return True
    moved, motion = np.diff(track.position, axis=0), formula.motion
    ahead = [_left_of(track.heading[:-1] + turn, moved) for turn in (motion.turn, -motion.turn)]
    return bool(((ahead[0] <= 0) & (ahead[0] >= -motion.height) & (ahead[1] >= 0) & (ahead[1] <= motion.height)).all())


def _left_of(direction: FloatArray, moved: FloatArray) -> FloatArray:
    left: FloatArray = np.cos(direction) * moved[:, 1] - np.sin(direction) * moved[:, 0]
    return left


def _track(name: str, truth: FloatArray) -> Track:
    velocity = truth[:, 3:] * np.column_stack([np.cos(truth[:, 2]), np.sin(truth[:, 2])])
    return Track(name, SAMPLE_TIME * np.arange(float(len(truth))), truth[:, :2], truth[:, 2], velocity)


def displacement_error(speed: float = 1.7) -> float:
    """m: how far the position after a sample may be from position plus ``SAMPLE_TIME`` times velocity; outer bound.

    With |v| <= ``speed`` and commands within the same limit, the speed changes by at most a·2·speed in a sample, a the
    part of the way to its command that it covers, so the length s of the arc differs from v·dt by at most
    dt·a·speed. The end of an arc of length s and turn D lies at most s·|D|/2 from where the tangent leads: the
    directions along the arc deviate by at most |D| times the part of the arc that is covered.
    """
    a, dt = CAR.speed_gain, CAR.dt
    s = dt * speed
    turn = s * math.tan(CAR.steering_limit) / CAR.wheel_base
    return dt * a * speed + s * turn / 2
