"""The simulated SVEA, a car of scale 1:10: its true dynamics, bounds of their derivatives, and its profile.

State (x m, y m, yaw rad, v m/s), inputs (steering rad, velocity m/s). Angles of the state are continuous
here; who publishes them wraps them.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fleet_bus.messages import VehicleProfile, parse_profile
from vehicle_agent.correction import published_bound

STATE_NAMES: Final = ("x", "y", "yaw", "v")
INPUT_NAMES: Final = ("steering", "velocity")

#: |v| in m/s up to which ``jacobian_bounds`` hold; commands of ±1.7 and process noise keep |v| below 1.76.
SPEED_COVERED: Final = 2.0

_OUTWARD: Final = 1e-9
# A command computed at the very rate limit must not exceed it when somebody takes the difference again.
_INWARD: Final = 1.0 - 1e-9


@dataclass(frozen=True, slots=True)
class SveaParameters:
    """Geometry, lags, actuator limits and noise half-widths; wheel base and limits as on the KTH SVEA."""

    wheel_base: float = 0.32  #: m
    speed_time_constant: float = 0.25  #: s
    steering_delay: int = 2  #: samples
    dt: float = 0.05  #: s
    steering_limit: float = 0.70  #: rad
    steering_rate: float = 3.0  #: rad/s
    velocity_limit: float = 1.7  #: m/s
    velocity_rate: float = 4.0  #: m/s²
    process_noise: tuple[float, float, float, float] = (
        0.001,
        0.001,
        0.002,
        0.01,
    )  #: m, m, rad, m/s; body frame
    sensor_noise: tuple[float, float, float, float] = (
        0.003,
        0.003,
        0.004,
        0.02,
    )  #: m, m, rad, m/s; world frame

    @property
    def dt_ns(self) -> int:
        """Sample time in nanoseconds."""
        return round(self.dt * 1e9)

    @property
    def speed_gain(self) -> float:
        """Part of the way to the commanded speed that one sample covers."""
        return -math.expm1(-self.dt / self.speed_time_constant)


def increment(
    parameters: SveaParameters, v: ArrayLike, steering: ArrayLike, velocity: ArrayLike
) -> NDArray[np.float64]:
    """Noise-free increment (..., 4) of one step in the body frame: d_x, d_y m, d_yaw rad, d_v m/s; exact.

    ``v`` (...) is the speed in m/s, ``steering`` (...) the command of ``steering_delay`` samples ago in rad,
    ``velocity`` (...) the speed command of now in m/s. Speed follows its command with a first-order lag, the
    car travels the arc of length s and curvature kappa of a kinematic bicycle:

        v+ = v + gain (velocity - v) ,  s = dt (v + v+)/2 ,  kappa = tan(steering)/wheel_base ,  D = s kappa ,
        d_x = s sin(D)/D ,  d_y = s (1 - cos D)/D ,  d_yaw = D ,  d_v = v+ - v .
    """
    v = np.asarray(v, dtype=np.float64)
    d_v = parameters.speed_gain * (velocity - v)
    s = parameters.dt * (v + d_v / 2)
    turn = s * np.tan(steering) / parameters.wheel_base
    half = turn / 2
    # sin(D)/D and (1 - cos D)/D = sin(D/2) sin(D/2)/(D/2), both smooth at 0; np.sinc(a) is sin(pi a)/(pi a)
    d_x = s * np.sinc(turn / np.pi)
    d_y = s * np.sin(half) * np.sinc(half / np.pi)
    return np.stack(np.broadcast_arrays(d_x, d_y, turn, d_v), axis=-1)


def step(
    parameters: SveaParameters,
    state: NDArray[np.float64],
    steering: ArrayLike,
    velocity: ArrayLike,
    noise: ArrayLike = 0.0,
) -> NDArray[np.float64]:
    """State (..., 4) one sample later: p+ = p + R(yaw)(d_xy + w_xy), yaw and v grow by theirs; exact.

    ``noise`` (..., 4) is the process noise w in the body frame; ``steering`` as in ``increment``.
    """
    d = increment(parameters, state[..., 3], steering, velocity) + np.asarray(noise, dtype=np.float64)
    cos, sin = np.cos(state[..., 2]), np.sin(state[..., 2])
    moved = np.stack(
        (cos * d[..., 0] - sin * d[..., 1], sin * d[..., 0] + cos * d[..., 1], d[..., 2], d[..., 3]), axis=-1
    )
    return state + moved


def limit_command(
    parameters: SveaParameters, wanted: NDArray[np.float64], previous: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The command (2) nearest to ``wanted`` that limits and rates allow one sample after ``previous`` (2)."""
    limit = np.array([parameters.steering_limit, parameters.velocity_limit])
    reach = np.array([parameters.steering_rate, parameters.velocity_rate]) * parameters.dt * _INWARD
    return np.clip(np.clip(wanted, previous - reach, previous + reach), -limit, limit)


def jacobian_bounds(parameters: SveaParameters) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Outer bounds (lower, upper), each (4, p), of the partial derivatives of ``increment``.

    Rows d_x, d_y, d_yaw, d_v; columns as ``VehicleProfile.regressors`` of ``profile``: v, then (steering,
    velocity) at lags 0 … steering_delay. They hold for |v| ≤ ``SPEED_COVERED`` and inputs within their
    limits, widened outwards by 1e-9.

    Derivation. With a = gain, s = dt ((1 - a/2) v + (a/2) velocity), D = s kappa, kappa =
    tan(steering)/wheel_base, and g(D) = sin(D)/D, h(D) = (1 - cos D)/D, so that D g = sin D and D h = 1 - cos
    D:

        d d_x/ds = (D g)' = cos D    d d_y/ds = (D h)' = sin D    d d_yaw/ds = kappa
        d d_x/dkappa = s² g'(D)      d d_y/dkappa = s² h'(D)      d d_yaw/dkappa = s
        ds/dv = dt (1 - a/2)         ds/dvelocity = dt a/2
        d d_v/dv = -a                d d_v/dvelocity = a
        dkappa/dsteering = (1 + tan²(steering))/wheel_base

    and every other derivative is zero. |s| ≤ S, |kappa| ≤ K at the ends of the ranges, |D| ≤ S K, which must
    stay below pi/2. There cos D ∈ [cos SK, 1], sin D is odd and increasing, g' is odd and decreasing, and h'
    is even, positive and decreasing away from 0 with h'(0) = 1/2, so s² h'(D) ∈ [0, S²/2].
    """
    a, dt = parameters.speed_gain, parameters.dt
    tan = math.tan(parameters.steering_limit)
    S = dt * ((1 - a / 2) * SPEED_COVERED + a / 2 * parameters.velocity_limit)
    K = tan / parameters.wheel_base
    D = S * K
    if not 0 < D < math.pi / 2:
        raise ValueError(f"the car may turn by {D:.3g} rad in one sample; the bounds are derived for (0, pi/2)")
    slope = (1 + tan * tan) / parameters.wheel_base
    g_slope = (math.sin(D) - D * math.cos(D)) / D**2

    by_s = np.array([[math.cos(D), 1.0], [-math.sin(D), math.sin(D)], [-K, K]])
    by_steering = np.array([[-(S**2) * g_slope, S**2 * g_slope], [0.0, S**2 / 2], [-S, S]]) * slope
    lower_upper = np.zeros((2, 4, 1 + 2 * (parameters.steering_delay + 1)))
    v, velocity, steering = 0, 2, 1 + 2 * parameters.steering_delay
    lower_upper[:, :3, v] = dt * (1 - a / 2) * by_s.T
    lower_upper[:, :3, velocity] = dt * a / 2 * by_s.T
    lower_upper[:, :3, steering] = by_steering.T
    lower_upper[:, 3, v], lower_upper[:, 3, velocity] = -a, a
    return lower_upper[0] - _OUTWARD, lower_upper[1] + _OUTWARD


def profile(parameters: SveaParameters | None = None) -> VehicleProfile:
    """Profile of the class ``svea``; every bound is given (that of the published state: correction.py)."""
    parameters = parameters or SveaParameters()
    lower, upper = jacobian_bounds(parameters)
    steering, velocity = parameters.steering_limit, parameters.velocity_limit
    return parse_profile(
        {
            "class": "svea",
            "state": {"x": "m", "y": "m", "yaw": {"unit": "rad", "angle": True}, "v": "m/s"},
            "inputs": {
                "steering": {
                    "unit": "rad",
                    "limits": [-steering, steering],
                    "rate": parameters.steering_rate,
                },
                "velocity": {
                    "unit": "m/s",
                    "limits": [-velocity, velocity],
                    "rate": parameters.velocity_rate,
                },
            },
            "sample_time": parameters.dt,
            "tolerance": 0.3,
            "frame": "body",
            "input_lags": parameters.steering_delay,
            "window": 1000,
            "noise": {
                "process": {"box": list(parameters.process_noise), "origin": "given"},
                "measurement": {"box": published_bound(parameters.sensor_noise).tolist(), "origin": "given"},
            },
            "lipschitz": {"lower": lower.tolist(), "upper": upper.tolist(), "origin": "given"},
            "future_inputs": "plan",
            "roles": {"position": ["x", "y"], "heading": "yaw", "speed": "v", "steering": "steering"},
            "horizon": 10,
            "maps_to": {"x1": "x", "x2": "y"},
        },
        "profile of the simulated SVEA",
    )
