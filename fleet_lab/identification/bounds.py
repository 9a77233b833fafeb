"""Bounds of process noise and slopes that one linear program finds consistent with recordings."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import RecordingError
from fleet_bus.messages import StateSample, VehicleProfile
from reach_server.data.regressors import RegressorSpec, Transitions, transitions
from reach_server.data.window import SampleBatch, Window
from reach_server.models.bound_estimation import consistent_bounds, noise_added
from reach_server.models.residual_model import NoiseBounds, least_squares

#: Transitions that the bounds are fitted to, evenly over all there are.
MOST_TRANSITIONS: Final = 1000


@dataclass(frozen=True, slots=True, eq=False)
class FittedBounds:
    """Consistent bounds: half-widths (n) of the process noise, and ``lower`` and ``upper`` (n, p) of the derivatives.

    ``measured`` (n) is what measurement noise adds to the residuals. A hypothesis, no guarantee.
    """

    process: NDArray[np.float64]
    measured: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    transitions: int

    def widened(self, margin: float) -> NDArray[np.float64]:
        """Process noise (n) such that all noise together is ``margin`` times as wide.

        A factor on the process noise alone would leave it zero where the measurement noise explains all residuals.
        """
        return np.asarray(self.process + (margin - 1.0) * (self.process + self.measured))


def fitted_bounds(samples: Sequence[StateSample], profile: VehicleProfile) -> FittedBounds:
    """The consistent bounds of least expected width for ``samples`` and the profile's measurement noise.

    Raises ``RecordingError`` where there are too few transitions for a model.
    """
    layout = RegressorSpec.of(profile)
    data = _thinned(_all_transitions(samples, profile, layout))
    count = int(data.usable.sum())
    if count < 2 * (layout.regressors + 1):
        raise RecordingError(
            f"{count} usable transitions for {layout.regressors + 1} coefficients of a model: give more recordings, "
            "fewer input_lags, or a tolerance that the sample intervals keep to"
        )
    matrix, _ = least_squares(data)
    noise = NoiseBounds.of(profile, layout).measurement
    half = np.abs(noise).sum(axis=1)
    found = consistent_bounds(data, layout, matrix, half)
    lower, upper = found.derivatives(matrix)
    return FittedBounds(found.w, noise_added(data, layout, matrix, half)[0], lower, upper, count)


def _all_transitions(samples: Sequence[StateSample], profile: VehicleProfile, layout: RegressorSpec) -> Transitions:
    window = Window(profile, len(samples))
    window.grow(1)
    window.append(SampleBatch.of(0, list(samples)))
    return transitions(window.block(np.zeros(1, dtype=np.intp)), layout)


def _thinned(data: Transitions) -> Transitions:
    """At most ``MOST_TRANSITIONS`` of the usable transitions, evenly chosen."""
    indices = np.flatnonzero(data.usable[0])
    if len(indices) > MOST_TRANSITIONS:
        indices = indices[np.linspace(0, len(indices) - 1, MOST_TRANSITIONS).round().astype(np.intp)]
    return Transitions(data.z[:, indices], data.target[:, indices], data.usable[:, indices], data.newest)
