"""Filters between sensor and bus; the bound of the published error holds whatever a filter believes."""

from typing import Final, Protocol

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import ArrayLike, NDArray

from fleet_bus.errors import MessageError, UsageError
from fleet_bus.messages import VehicleProfile
from vehicle_agent.angles import wrap
from vehicle_agent.correction import CORRECTION, correct, sensor_bound

#: σ_a dt²/σ_z: how far an unforeseen acceleration moves the state within a sample, over the sensor's noise.
TRACKING_INDEX: Final = 3.0

#: An estimate further than this from what was measured, in deviations of the sensor, has lost the vehicle: rounding at
#: that distance is no longer small beside the sensor's error.
LOST: Final = 1e9

#: Bounds below this count as none, those above its inverse as unusable: their squares leave the range of doubles.
_LEAST_BOUND: Final = 1e-60


class Filter(Protocol):
    """Turns measurements of one vehicle into the states that are published.

    What a measurement that is refused, or one that is far off, leaves behind never outlasts the next sound one.
    """

    @property
    def restarts(self) -> int:
        """How often the estimate was lost and began anew with a measurement, beside ``reset``."""

    def reset(self) -> None:
        """Forget everything: what comes next does not follow from what came before."""

    def update(self, t: int, measured: NDArray[np.float64]) -> NDArray[np.float64]:
        """Published state (n) for the state ``measured`` (n) at ``t`` ns, later than the call before.

        Raises ``MessageError`` for a measurement that holds NaN or an infinity; it leaves no trace.
        """


class PassThrough:
    """Publishes what was measured."""

    restarts: Final = 0

    def reset(self) -> None:
        """Nothing is remembered."""

    def update(self, t: int, measured: NDArray[np.float64]) -> NDArray[np.float64]:
        """``measured`` itself (n); raise ``MessageError`` where it is not finite."""
        return _finite(measured)


class KinematicFilter:
    """Constant-velocity Kalman filter of each state component, its correction bounded.

    What is published lies within ``correction * bound`` of the measurement, so that the bound of its error is
    known (correction.py).

    Angles are unwrapped inside (successive measurements less than half a turn apart) and published in
    (-pi, pi], the error being that on the circle.

    An estimate that overflows, or is further than ``LOST`` from what was measured, is given up: the filter begins anew
    with that measurement, which is published as it is, and ``restarts`` counts it.

    Args:
        bound: the sensor's half-widths b (n), in the units of the state.
        sample_time: nominal sample time in s, to which ``tracking_index`` refers; real intervals may vary.
        angles: mask (n) of the components that wrap; default none.
        correction: kappa ≥ 0.
        tracking_index: agility of the filter, see ``TRACKING_INDEX``.

    Raises ``UsageError`` for a negative or non-finite argument, and for numbers whose squares are no longer finite.
    """

    def __init__(
        self,
        bound: ArrayLike,
        sample_time: float,
        *,
        angles: ArrayLike | None = None,
        correction: float = CORRECTION,
        tracking_index: float = TRACKING_INDEX,
    ) -> None:
        self._bound = np.array(bound, dtype=np.float64)
        n = len(self._bound)
        self._angles = np.zeros(n, dtype=bool) if angles is None else np.array(angles, dtype=bool)
        if self._angles.shape != (n,):
            raise UsageError(f"the mask of angles has shape {self._angles.shape}, the bound has {n} components")
        numbers = np.array([*self._bound, sample_time, correction, tracking_index])
        if not np.isfinite(numbers).all() or (numbers < 0).any() or sample_time == 0:
            raise UsageError(
                f"bound {self._bound.tolist()}, sample time {sample_time} s, correction {correction} and "
                f"tracking index {tracking_index} must be finite and not negative, the sample time positive"
            )
        self._correction = correction
        # Standard deviation of the uniform distribution; any positive one will do where the bound is zero.
        self._sigma = np.where(self._bound > _LEAST_BOUND, self._bound, 1.0) / np.sqrt(3.0)
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            self._acceleration = np.diag((tracking_index * self._sigma / np.float64(sample_time) ** 2) ** 2)
            self._noise = np.diag(self._sigma**2)
            self._first_rate = np.diag((self._sigma / sample_time) ** 2) * 1e4
        made = np.stack([self._acceleration, self._noise, self._first_rate])
        if (self._bound > 1 / _LEAST_BOUND).any() or not np.isfinite(made).all():
            raise UsageError(
                f"bound {self._bound.tolist()}, sample time {sample_time} s and tracking index {tracking_index} lead "
                "out of the range of numbers: state them in other units"
            )
        self.restarts = 0
        self._kalman = KalmanFilter(dim_x=2 * n, dim_z=n)
        self._kalman.H = np.eye(n, 2 * n)
        self._kalman.R = self._noise
        self._started = False
        self._t = 0
        self._dt = 0.0
        self._measured = np.zeros(n)

    def reset(self) -> None:
        """Start anew with the next measurement."""
        self._started = False

    def update(self, t: int, measured: NDArray[np.float64]) -> NDArray[np.float64]:
        """Published state (n) for the state ``measured`` (n) at ``t`` ns, later than the call before.

        If ``measured`` is within ``bound`` of the truth, this is within ``(1 + correction) * bound`` of it. Raises
        ``MessageError`` for a measurement that holds NaN or an infinity; it leaves no trace.
        """
        measured = _finite(measured)
        measured = np.where(self._angles, wrap(measured), measured)
        if self._started and not self._follow((t - self._t) / 1e9, measured):
            self._started = False
            self.restarts += 1
        if not self._started:
            self._begin(measured)
        self._t = t
        turns = measured - self._measured
        estimate = self._kalman.x[: len(measured)] + turns
        published = correct(measured, estimate, self._bound, self._correction)
        return np.where(self._angles, wrap(published), published)

    def _follow(self, dt: float, measured: NDArray[np.float64]) -> bool:
        """Go on for ``dt`` s to a measurement; whether there is still an estimate worth the name."""
        if dt <= 0:
            return False
        with np.errstate(all="ignore"):
            turned = measured - self._measured
            self._measured = self._measured + np.where(self._angles, wrap(turned), turned)
            try:
                self._move(dt)
                self._kalman.predict()
                innovation = self._measured - self._kalman.x[: len(measured)]
                if not (np.abs(innovation) <= LOST * self._sigma).all():
                    return False
                self._kalman.update(self._measured)
            # Where the covariance is no longer one.
            except np.linalg.LinAlgError:
                return False
        return bool(np.isfinite(self._kalman.x).all() and np.isfinite(self._kalman.P).all())

    def _begin(self, measured: NDArray[np.float64]) -> None:
        zero = np.zeros_like(self._noise)
        self._kalman.x = np.concatenate((measured, np.zeros(len(measured))))
        self._kalman.P = np.block([[self._noise, zero], [zero, self._first_rate]])
        self._measured = measured.copy()
        self._started = True

    def _move(self, dt: float) -> None:
        if dt != self._dt:
            eye, a = np.eye(len(self._bound)), self._acceleration
            self._kalman.F = np.block([[eye, dt * eye], [0 * eye, eye]])
            self._kalman.Q = np.block([[dt**4 / 4 * a, dt**3 / 2 * a], [dt**3 / 2 * a, dt**2 * a]])
            self._dt = dt


def _finite(measured: NDArray[np.float64]) -> NDArray[np.float64]:
    if not np.isfinite(measured).all():
        raise MessageError("not_finite", f"measured {measured.tolist()}")
    return measured


def filter_for(profile: VehicleProfile, *, correction: float = CORRECTION) -> Filter:
    """The filter that keeps ``profile.noise.measurement``, given a sensor that keeps its part of it.

    The sensor's bound is the profile's over ``1 + correction``. Without a measurement bound, or with one that
    is not a box (a correction per component would leave it), measurements pass through.
    """
    noise = profile.noise.measurement
    if noise is None or noise.box is None:
        return PassThrough()
    bound = sensor_bound(noise.box, correction)
    return KinematicFilter(bound, profile.sample_time, angles=profile.angles, correction=correction)
