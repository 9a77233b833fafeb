"""Simulated drives: a car, and what it does on a route, before it and after it. All of it repeats by seed."""

import math
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import UsageError
from vehicle_agent.angles import wrap
from vehicle_agent.driver import Driver
from vehicle_agent.path import draw_path
from vehicle_agent.route import Route
from vehicle_agent.svea import SveaParameters, limit_command, step

#: Least length of a history: it ends at rest, which takes a while.
LEAST_HISTORY: Final = 64

_AT_REST: Final = 32
_SPEEDS: Final = (-0.4, 1.65)
_CORRELATION: Final = 0.25

# One stream of random numbers per purpose, so that a longer history does not change the drive.
_HISTORY_STREAM, _DRIVE_STREAM, _STAND_STREAM = range(3)


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """K samples, one sample time apart.

    Attributes:
        truth: true states (K, 4), yaw in (-pi, pi].
        measured: what the sensor said (K, 4), yaw in (-pi, pi].
        inputs: commands (K, 2) in force from each sample on.
        tries: how many drives were simulated to get this one.
    """

    truth: NDArray[np.float64]
    measured: NDArray[np.float64]
    inputs: NDArray[np.float64]
    tries: int = 1


class Car:
    """A true state that moves by ``svea.step`` with process noise, and a sensor.

    It begins with ``state`` (4) and the last ``steering_delay`` commands ``steering`` (rad), default zeros.
    """

    def __init__(
        self,
        parameters: SveaParameters,
        state: NDArray[np.float64],
        rng: np.random.Generator,
        steering: Iterable[float] | None = None,
    ) -> None:
        self.state = _wrapped(state)
        self._parameters = parameters
        self._rng = rng
        delay = parameters.steering_delay
        self._steering = deque([0.0] * delay if steering is None else steering, maxlen=delay + 1)

    def measure(self) -> NDArray[np.float64]:
        """The state (4) with an error uniform in the sensor's box."""
        bound = np.array(self._parameters.sensor_noise)
        return _wrapped(self.state + self._rng.uniform(-bound, bound))

    def advance(self, command: NDArray[np.float64]) -> None:
        """Move on by one sample under ``command`` (2)."""
        bound = np.array(self._parameters.process_noise)
        self._steering.append(float(command[0]))
        steering = self._steering.popleft()
        noise = self._rng.uniform(-bound, bound)
        self.state = _wrapped(step(self._parameters, self.state, steering, command[1], noise))


def simulate_drive(route: Route, seed: int, parameters: SveaParameters | None = None, *, tries: int = 200) -> Drive:
    """Drive on a variation of ``route`` whose true samples obey it, from t = 0 to its end; starts at rest.

    Variations are drawn until one obeys; raises ``UsageError`` after ``tries`` of them.
    """
    parameters = parameters or SveaParameters()
    count = math.floor(route.duration / parameters.dt + 1e-9) + 1
    t = np.arange(count, dtype=np.float64) * parameters.dt
    nearest = np.full(len(route.zones), -np.inf)
    for attempt in range(tries):
        rng = np.random.default_rng([seed, _DRIVE_STREAM, attempt])
        path = draw_path(route, rng)
        driver = Driver(parameters, path)
        car = Car(parameters, np.append(path.start, 0.0), rng)
        truth, measured, inputs = np.empty((count, 4)), np.empty((count, 4)), np.empty((count, 2))
        for k in range(count):
            truth[k], measured[k] = car.state, car.measure()
            inputs[k] = driver.command(t[k], measured[k])
            car.advance(inputs[k])
        if route.obeyed(t, truth[:, :2]):
            return Drive(truth, measured, inputs, attempt + 1)
        nearest = np.maximum(nearest, route.clearance(t, truth[:, :2]))
    best = {zone.name: round(float(c), 3) for zone, c in zip(route.zones, nearest, strict=True)}
    raise UsageError(
        f"route {route.route}: none of {tries} drives of seed {seed} stays {route.margin} m inside its zones "
        f"(best clearance in m: {best}); move the way points or widen the zones"
    )


def simulate_history(seed: int, samples: int, parameters: SveaParameters | None = None) -> Drive:
    """Free drive of ``samples`` (0 or ≥ ``LEAST_HISTORY``) over all speeds and steering angles; ends at rest.

    Commands are smooth Gaussian signals (two first-order lags in a row) turned uniform over their range, so
    that every speed meets every steering angle. Raises ``UsageError`` for another number of samples.
    """
    if samples != 0 and samples < LEAST_HISTORY:
        raise UsageError(f"a history of {samples} samples is too short: give 0 or at least {LEAST_HISTORY}")
    parameters = parameters or SveaParameters()
    rng = np.random.default_rng([seed, _HISTORY_STREAM])
    wanted = _excitation(parameters, samples, rng)
    wanted[max(samples - _AT_REST, 0) :] = 0.0
    car = Car(parameters, np.append(rng.uniform(-1, 1, 2), [rng.uniform(-np.pi, np.pi), 0.0]), rng)
    truth, measured, inputs = np.empty((samples, 4)), np.empty((samples, 4)), np.empty((samples, 2))
    command = np.zeros(2)
    for k in range(samples):
        truth[k], measured[k] = car.state, car.measure()
        inputs[k] = command = limit_command(parameters, wanted[k], command)
        car.advance(command)
    return Drive(truth, measured, inputs)


def stand_still(
    drive: Drive, seed: int, parameters: SveaParameters | None = None
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]]:
    """What follows ``drive``, without end: (truth (4), measured (4), command (2)) of a car that stops."""
    parameters = parameters or SveaParameters()
    rng = np.random.default_rng([seed, _STAND_STREAM])
    command = drive.inputs[-1]
    before = np.append(np.zeros(parameters.steering_delay), drive.inputs[:-1, 0])
    car = Car(parameters, drive.truth[-1], rng, before[len(before) - parameters.steering_delay :].tolist())
    while True:
        car.advance(command)
        command = limit_command(parameters, np.zeros(2), command)
        yield car.state, car.measure(), command


def _excitation(parameters: SveaParameters, samples: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Commands (samples, 2) that are smooth in time and uniform over the range."""
    keep = math.exp(-parameters.dt / _CORRELATION)
    # Stationary variance of white noise after two lags x <- keep x + (1 - keep) w in a row.
    gain = (1 - keep) ** 4 * (1 + keep**2) / (1 - keep**2) ** 3
    warm_up = round(5 * _CORRELATION / parameters.dt)
    signal = np.zeros((warm_up + samples, 2))
    first = second = np.zeros(2)
    for k, white in enumerate(rng.standard_normal(signal.shape)):
        first = keep * first + (1 - keep) * white
        second = keep * second + (1 - keep) * first
        signal[k] = second / math.sqrt(gain)
    uniform = np.array([math.erf(value / math.sqrt(2)) for value in signal[warm_up:].flat])
    half = np.array([parameters.steering_limit, (_SPEEDS[1] - _SPEEDS[0]) / 2])
    middle = np.array([0.0, sum(_SPEEDS) / 2])
    commands: NDArray[np.float64] = middle + half * uniform.reshape(samples, 2)
    return commands


def _wrapped(state: NDArray[np.float64]) -> NDArray[np.float64]:
    turned = state.copy()
    turned[2] = wrap(state[2])
    return turned
