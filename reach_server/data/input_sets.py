"""Sets of the inputs of the coming steps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import VehicleProfile
from reach_server.numeric.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class InputSets:
    """Boxes of the inputs: ``past`` (B, lags, m) known values, newest first; ``center``, ``half`` (B, N, m)."""

    past: FloatArray
    center: FloatArray
    half: FloatArray


def future_inputs(
    profile: VehicleProfile,
    past: FloatArray,
    current: FloatArray,
    current_known: NDArray[np.bool_],
    horizon: int,
    plan: FloatArray | None = None,
    tolerance: FloatArray | None = None,
) -> InputSets:
    """Boxes of the inputs of steps 0 to N-1 for B vehicles.

    ``past`` (B, lags, m) newest first and ``current`` (B, m) are known points; where ``current_known`` (B,) is False
    the current one may be anything within the limits. Later inputs: the ``plan`` (B, N - 1, m) with its ``tolerance``
    (B, m) if one is given, else the limits, narrowed by ``future_inputs: rate`` to what the rate limit lets the input
    reach from the current one. An outer bound of the inputs as long as limits, rates and plan are kept.
    """
    vehicles, m = current.shape
    low, high = limits(profile)
    lower = np.broadcast_to(low, (vehicles, horizon, m)).copy()
    upper = np.broadcast_to(high, (vehicles, horizon, m)).copy()
    known = current_known[:, None]
    lower[:, 0] = np.where(known, current, low)
    upper[:, 0] = np.where(known, current, high)
    if plan is not None:
        margin = np.zeros((vehicles, m)) if tolerance is None else tolerance
        lower[:, 1:], upper[:, 1:] = plan - margin[:, None], plan + margin[:, None]
    elif profile.future_inputs == "rate":
        rates = np.array([np.inf if spec.rate is None else spec.rate for spec in profile.inputs.values()])
        reach = rates * profile.sample_time * np.arange(1, horizon)[:, None]
        # A command outside of its limits can only come back towards them.
        first_low, first_high = np.minimum(lower[:, :1], low), np.maximum(upper[:, :1], high)
        lower[:, 1:] = np.clip(lower[:, :1] - reach, first_low, high)
        upper[:, 1:] = np.clip(upper[:, :1] + reach, low, first_high)
    return InputSets(past, (lower + upper) / 2, (upper - lower) / 2)


def limits(profile: VehicleProfile) -> tuple[FloatArray, FloatArray]:
    """Lower and upper limits (m,) of the inputs, infinite where the profile states none."""
    bounds = [(-np.inf, np.inf) if spec.limits is None else spec.limits for spec in profile.inputs.values()]
    array = np.array(bounds, dtype=np.float64).reshape(-1, 2)
    return array[:, 0], array[:, 1]
