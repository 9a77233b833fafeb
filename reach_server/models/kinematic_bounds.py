"""Kinematic bounds: where a vehicle can be by its stated limits alone, used as its sets while it has no model, then as
their bound."""

from dataclasses import dataclass

import numpy as np

from fleet_bus.messages import VehicleProfile
from fleet_bus.messages.profile import StateSpec
from reach_server.numeric.types import FloatArray

#: Half-widths are enlarged by this share against rounding.
OUTWARDS = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Ahead:
    """Bounds of the states 1 to N sample times after received ones: ``low`` and ``high`` (B, N, n); ``distance`` (B, N)
    bounds how far the true position gets from where it is now, and ``error`` (n,) are the half-widths of the stated
    measurement noise, zero where none is. What nothing bounds is infinite."""

    low: FloatArray
    high: FloatArray
    distance: FloatArray
    error: FloatArray


def states_limits(profile: VehicleProfile) -> bool:
    """Whether a profile states any limit or rate of a state."""
    return any(spec.limits is not None or spec.rate is not None for spec in profile.state.values())


def limits_ahead(profile: VehicleProfile, x: FloatArray, horizon: int) -> Ahead:
    """Bounds of the true states 1 to N sample times after the received states ``x`` (B, n): outer, if what the profile
    states of states and measurement holds.

    Let e be the half-widths of the stated measurement noise (zero where none is stated: the label then claims nothing).
    The true state now lies within ``x ± e``, and t seconds later

    * ``|x_i(t) - x_i(0)| <= rate_i t``, with the ``rate`` of the state;
    * for the positions ``|p(t) - p(0)| <= ∫ |v| dτ``, with ``|v(τ)| <= min(V, |v(0)| + e_v + rate_v τ)`` where V is the
      greatest magnitude within the limits of ``roles.speed``, or infinite: integrated exactly. With a role
      ``lateral_speed`` its integral is added; without one, ``speed`` is taken to be that of the reference point. The
      smaller of this and the bound above counts;
    * ``x_i(t)`` within the ``limits`` of the state. They are not used for angles, which may be in any turn, nor where
      ``x ± e`` lies outside of them and so proves them wrong.
    """
    states = list(profile.state.values())
    error = np.zeros(len(states))
    if profile.noise.measurement is not None:
        error = np.abs(profile.noise.measurement.matrix()).sum(axis=1)
    t: FloatArray = profile.sample_time * np.arange(1.0, horizon + 1)
    distance = np.full((len(x), horizon), np.inf)
    rate = np.array([np.inf if spec.rate is None else spec.rate for spec in states])
    change = np.broadcast_to(t[:, None] * rate, (len(x), horizon, len(states))).copy()
    positions = list(profile.position) if profile.roles.position is not None else []
    if positions:
        distance = _distance(profile, x, error, t)
        change[..., positions] = np.minimum(change[..., positions], distance[..., None])
    low, high = x[:, None] - error - change, x[:, None] + error + change
    for i, spec in enumerate(states):
        if spec.limits is not None and not spec.angle:
            least, greatest = spec.limits
            right = (x[:, i] + error[i] >= least) & (x[:, i] - error[i] <= greatest)
            low[right, :, i] = np.maximum(low[right, :, i], least)
            high[right, :, i] = np.minimum(high[right, :, i], greatest)
    return Ahead(low, high, distance, error)


def limit_sets(profile: VehicleProfile, x: FloatArray, horizon: int) -> tuple[FloatArray, FloatArray] | None:
    """Centres (B, N, n) and diagonal generators (B, N, n, n) of boxes that hold the true states 1 to N sample times
    after the received states ``x`` (B, n); None where the profile does not bound every state. Outer bounds
    (``limits_ahead``); a vehicle whose received state proves wrong what alone bounds a state has infinite
    generators."""
    ahead = limits_ahead(profile, x, horizon)
    low, high = ahead.low, ahead.high
    bounded = np.isfinite(low) & np.isfinite(high)
    if len(x) and not bounded.all(axis=(1, 2)).any():
        return None
    low, high = (np.where(bounded, bound, x[:, None]) for bound in (low, high))
    center = (low + high) / 2
    half = np.where(bounded, (high - low) / 2 * (1 + OUTWARDS) + np.spacing(np.abs(center)), np.inf)
    n = x.shape[1]
    generators = np.zeros((*half.shape, n))
    generators[..., np.arange(n), np.arange(n)] = half
    return center, generators


def _distance(profile: VehicleProfile, x: FloatArray, error: FloatArray, t: FloatArray) -> FloatArray:
    """Bound (B, N) of the distance that a vehicle covers in the times ``t`` (N,)."""
    distance = np.full((len(x), len(t)), np.inf)
    if profile.roles.speed is None:
        return distance
    distance = np.zeros_like(distance)
    for name in (profile.roles.speed, profile.roles.lateral_speed):
        if name is not None:
            i = profile.state_names.index(name)
            distance += _integral(profile.state[name], np.abs(x[:, [i]]), error[i], t)
    return distance


def _integral(spec: StateSpec, received: FloatArray, error: float, t: FloatArray) -> FloatArray:
    """``∫ min(V, v + a τ) dτ`` from 0 to each t (N,), v the received speed (B, 1) plus its error: (B, N)."""
    top = np.inf if spec.limits is None else max(abs(spec.limits[0]), abs(spec.limits[1]))
    tops = np.where(received - error > top, np.inf, top)
    if spec.rate is None:
        return np.asarray(tops * t)
    speed = np.minimum(received + error, tops)
    gains = np.minimum(t, (tops - speed) / spec.rate)
    return np.asarray(speed * t + spec.rate * gains * (t - gains / 2))
