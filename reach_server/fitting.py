"""When models are fitted, and the newest one of each vehicle."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Lipschitz, VehicleProfile
from reach_server import calibrated, model
from reach_server.regression import Layout, transitions
from reach_server.rows import scatter, take, with_room
from reach_server.windows import Window

#: A vehicle's model is fitted again after this many new samples.
REFIT_EVERY = 10
#: Data per unknown below which a model is not worth publishing from.
DATA_PER_UNKNOWN = 2


class Models:
    """Models of the vehicles of a class, by slot; residual models or calibrated ones."""

    def __init__(
        self,
        profile: VehicleProfile,
        layout: Layout,
        bounds: model.NoiseBounds,
        lipschitz: Lipschitz | None,
        *,
        horizon: int,
        is_calibrated: bool,
        planned: bool,
    ) -> None:
        self._profile = profile
        self._layout = layout
        self._bounds = bounds
        self._lipschitz = lipschitz
        self._horizon = horizon
        self._is_calibrated = is_calibrated
        self._planned = planned
        self._store: Any = None
        self._since = np.zeros(0, dtype=np.int64)
        self._fitted = np.zeros(0, dtype=bool)

    def grow(self, slots: int) -> None:
        """Make room for ``slots`` vehicles."""
        self._since = with_room(self._since, slots, self._since)
        self._fitted = with_room(self._fitted, slots, self._fitted)

    def reset(self, slot: int) -> None:
        """Forget the model of one vehicle."""
        self._fitted[slot] = False
        self._since[slot] = 0

    def count(self, slots: NDArray[np.intp]) -> None:
        """Take note of one new sample for each entry of ``slots``."""
        self._since += np.bincount(slots, minlength=len(self._since))

    def ready(self, slots: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Which vehicles have a model."""
        return np.asarray(self._fitted[slots])

    def of(self, slots: NDArray[np.intp]) -> Any:
        """``model.Model`` or ``calibrated.Calibrated`` with the rows of some vehicles that are ready."""
        return take(self._store, slots)

    def rank_deficient(self, slots: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Which of some vehicles that are ready have data that does not determine their model."""
        if self._is_calibrated:
            return np.zeros(len(slots), dtype=bool)
        return np.asarray(self._store.rank_deficient[slots])

    def refit(self, window: Window, slots: NDArray[np.intp]) -> None:
        """Fit where enough new samples have come; later fits of the vehicles are spread over the ticks by slot."""
        due = slots[~self._fitted[slots] | (self._since[slots] >= REFIT_EVERY)]
        if not len(due):
            return
        block = window.block(due)
        if self._is_calibrated:
            fitted: Any = calibrated.fit(block, self._profile, self._layout, self._horizon, planned=self._planned)
            unknowns = fitted.mean.shape[1]
            least = max(calibrated.least_scores(self._profile.confidence), DATA_PER_UNKNOWN * unknowns)
            enough = np.isfinite(fitted.half).all(axis=(1, 2)) & (fitted.scores >= least)
            fitted = take(fitted, enough)
        else:
            data = transitions(block, self._layout)
            enough = data.usable.sum(axis=1) >= DATA_PER_UNKNOWN * (1 + self._layout.regressors)
            if enough.any():
                fitted = model.fit(take(data, enough), self._layout, self._bounds, self._lipschitz)
        due = due[enough]
        if not len(due):
            return
        self._store = scatter(self._store, due, fitted)
        self._since[due] = np.where(self._fitted[due], 0, due % REFIT_EVERY)
        self._fitted[due] = True
