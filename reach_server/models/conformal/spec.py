"""What enters the horizon model: which columns its features have, in an order of which each step uses the front part.

    b = [1, s, d_{k-1}, ..., d_{k-l}, u_k, ..., u_{k-q}, v r, v², v² r, v r², v·steer_k, ..., v·steer_{k-q}]
    then for each later step j whose inputs are known: [u_{k+j}, v·steer_{k+j}]

with the states s that the model depends on, increments d per second in the frame of the sample before, and the last
yaw rate r. An angle among s enters by its cosine and sine. The more inputs lag, the more increments enter: where the
pose is noisy, a mean over several is what says how fast a vehicle moves.
"""

from typing import NamedTuple

import numpy as np

from fleet_bus.messages import VehicleProfile
from reach_server.data.regressors import RegressorSpec
from reach_server.numeric.types import IntArray

#: Fewest and most lagged increments; between them, half as many as inputs lag.
LEAST_INCREMENTS, MOST_INCREMENTS = 2, 6


class FeatureSpec(NamedTuple):
    """The columns of the features, for compiled loops.

    ``n`` states, ``m`` inputs, ``horizon`` steps N; ``lags`` of inputs, ``increments`` that enter, ``reach`` samples
    that the features look back. ``first, second, heading`` name the pose where increments turn with the vehicle, else
    -1; ``speed`` and ``steering`` are a state and an input, or -1. ``free`` are the states s and ``angles`` those that
    wrap, as bits: compiled functions hand plain numbers on faster than arrays. ``base`` columns are known at sample k,
    ``later`` more for each step of known inputs; ``total`` in all. ``at_increments``, ``at_inputs``, ``at_products``
    are columns where parts begin; ``sizes`` the number of regressors ψ of the size of errors. ``interval`` is the
    sample time in ns. ``planar`` are the states that are positions, as bits, ``groups`` the number of groups that have
    margins of their own: positions, and other states if there are any.
    """

    n: int
    m: int
    horizon: int
    lags: int
    increments: int
    reach: int
    first: int
    second: int
    heading: int
    speed: int
    steering: int
    free: int
    angles: int
    planned: bool
    base: int
    later: int
    total: int
    at_increments: int
    at_inputs: int
    at_products: int
    sizes: int
    interval: int
    planar: int
    groups: int

    @classmethod
    def of(cls, profile: VehicleProfile, layout: RegressorSpec, horizon: int, *, planned: bool) -> "FeatureSpec":
        """Columns of a profile; with ``planned`` the later inputs are among them."""
        n, m, lags = layout.n, layout.m, layout.lags
        increments = min(max(lags // 2, LEAST_INCREMENTS), MOST_INCREMENTS)
        roles = profile.roles
        speed = -1 if roles.speed is None else profile.state_names.index(roles.speed)
        steering = -1 if roles.steering is None or speed < 0 else profile.input_names.index(roles.steering)
        first, second, heading = layout.pose or (-1, -1, -1)
        at_increments = 1 + len(layout.free) + len(set(layout.free) & set(layout.angles))
        at_inputs = at_increments + increments * n
        at_products = at_inputs + (lags + 1) * m
        steers = int(steering >= 0)
        turning = speed >= 0 and heading >= 0
        base = at_products + 4 * turning + steers * (lags + 1)
        later = m + steers if planned else 0
        # 1, |v|, |r|, |v r|, range of each input, |v| range(steer), change of each free state, roughness of each state
        sizes = 1 + (speed >= 0) + 2 * turning + m + steers + len(layout.free) + n
        return cls(
            n, m, horizon, lags, increments, max(lags, increments), first, second, heading, speed, steering,
            sum(1 << i for i in layout.free), sum(1 << i for i in layout.angles), planned, base, later,
            base + later * (horizon - 1), at_increments, at_inputs, at_products, sizes, profile.sample_time_ns,
            sum(1 << i for i in set(profile.position)), 2 if n > len(set(profile.position)) else 1,
        )  # fmt: skip


def owners(profile: VehicleProfile, layout: RegressorSpec, spec: FeatureSpec) -> IntArray:
    """The state (from 0) or input (from n) that each feature (total,) tells of, -1 for the constant. Products belong to
    the steering, and those of the speed and the yaw rate to the heading or, where that has no part, to the speed."""
    n, m = spec.n, spec.m
    found = [-1]
    for i in layout.free:
        found += [i] * (1 + (i in layout.angles))
    found += list(range(n)) * spec.increments
    found += list(range(n, n + m)) * (spec.lags + 1)
    if spec.speed >= 0:
        if spec.heading >= 0:
            found += [spec.heading, spec.speed, spec.heading, spec.heading]
        if spec.steering >= 0:
            found += [n + spec.steering] * (spec.lags + 1)
    later = [*range(n, n + m), *([n + spec.steering] if spec.steering >= 0 else [])]
    if spec.planned:
        found += later * (spec.horizon - 1)
    return np.array(found, dtype=np.int64)
