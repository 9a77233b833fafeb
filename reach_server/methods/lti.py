"""Method ``lti``: sets moved from step to step by all linear models that agree with the data."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import UsageError
from fleet_bus.messages import VehicleProfile
from reach_server.audit.labels import Claim
from reach_server.data.observed_range import Seen
from reach_server.data.readiness import samples_missing
from reach_server.data.regressors import RegressorSpec, transitions
from reach_server.data.window import Block, Window
from reach_server.methods.base import Outlook, Reason
from reach_server.methods.registry import Setup, register
from reach_server.methods.request import PlannedInputs, TubeRequest
from reach_server.methods.set_membership import input_sets, inputs_unlimited, lags_missing, outlook_of, received
from reach_server.models import matrix_zonotope as lti
from reach_server.models.residual_model import NoiseBounds
from reach_server.numeric.slot_table import grow_rows, scatter_rows, take_rows
from reach_server.numeric.types import IndexArray
from reach_server.sets.raw import RawSets
from reach_server.tube.cut_schedule import CutSchedule
from reach_server.tube.unbranched import UnbranchedTubes

#: Samples after which the models of a vehicle are found anew; what agreed with older data still does.
REFIT_EVERY = 10
#: Data per unknown below which models are not worth publishing from.
DATA_PER_UNKNOWN = 2


@dataclass(frozen=True, slots=True, eq=False)
class LinearForecast:
    """Sets that begin at the received state and are moved by all models that agree with the data."""

    start: RawSets
    motion: lti.LinearMotion
    outlook: Outlook

    def ahead(self) -> None:
        """Each set follows from the one before."""

    def unbranched(self, rows: IndexArray, schedule: CutSchedule) -> UnbranchedTubes | None:
        """None: every vehicle is moved step by step."""
        return None


class Linear:
    """All linear models of the vehicles of a class that agree with their data."""

    claims_measured = False
    frozen = False
    notes: tuple[str, ...] = ()

    def __init__(self, profile: VehicleProfile, window: Window, horizon: int) -> None:
        self._profile = profile
        self._window = window
        self._horizon = horizon
        self._layout = RegressorSpec.of(profile)
        if self._layout.pose is not None:
            raise UsageError("method lti describes linear systems: it needs frame: world")
        self.bounds = NoiseBounds.of(profile, self._layout)
        self.samples_needed = self._layout.lags + 1
        self.lipschitz = profile.lipschitz
        self._store: Any = None
        self._seen: Any = None
        self._fitted_at = np.zeros(0, dtype=np.int64)
        self._data = np.zeros(0, dtype=np.int64)

    @property
    def _least(self) -> int:
        return DATA_PER_UNKNOWN * self._layout.regressors

    def grow(self, slots: int) -> None:
        """See ``Method``."""
        self._fitted_at = grow_rows(self._fitted_at, slots, self._fitted_at)
        self._data = grow_rows(self._data, slots, self._data)

    def reset(self, slot: int) -> None:
        """See ``Method``."""
        self._fitted_at[slot] = self._data[slot] = 0

    def learn(self, slots: IndexArray) -> None:
        """See ``Method``."""
        count = self._window.count[slots]
        # The window of a vehicle that came back with an older epoch counts anew.
        fitted_at = self._fitted_at[slots] = np.where(count < self._fitted_at[slots], 0, self._fitted_at[slots])
        due = slots[(fitted_at == 0) | (count - fitted_at >= REFIT_EVERY)]
        due = due[self._window.filled(due) > self._least]
        if not len(due):
            return
        data = transitions(self._window.block(due), self._layout)
        self._data[due] = data.usable.sum(axis=1)
        enough = self._data[due] >= self._least
        if enough.any():
            models = lti.fit(take_rows(data, enough), self._layout, self.bounds, self.lipschitz)
            self._store = scatter_rows(self._store, due[enough], models)
            self._seen = scatter_rows(self._seen, due[enough], Seen.of(take_rows(data, enough)))
            self._fitted_at[due[enough]] = self._window.count[due[enough]]

    def missing(self, slots: IndexArray) -> NDArray[np.int64]:
        """See ``Method``."""
        lacking = samples_missing(self._window, slots, self._data[slots], self._least, self._layout.lags + 1)
        return np.asarray(np.where(self._fitted_at[slots] > 0, 0, np.maximum(lacking, 1)))

    def glitches(self) -> list[tuple[int, int]]:
        """None: stated bounds hold for every sample."""
        return []

    def reasons(self, slots: IndexArray, block: Block, known: PlannedInputs | None) -> list[Reason]:
        """See ``Method``."""
        return [
            lags_missing(block, self._layout),
            inputs_unlimited(self._profile, self._horizon, block, known),
            (self.rank_deficient(slots), "the data does not determine a linear model: drive with more excitation"),
        ]

    def rank_deficient(self, slots: IndexArray) -> NDArray[np.bool_]:
        """See ``Method``."""
        lacking = np.zeros(len(slots), dtype=bool)
        fitted = self._fitted_at[slots] > 0
        if fitted.any():
            lacking[fitted] = ~self._store.determined[slots[fitted]]
        return lacking

    def forecast(self, request: TubeRequest) -> LinearForecast:
        """See ``Method``."""
        models = take_rows(self._store, request.slots)
        start = received(request, self._layout, self.bounds, models.newest)
        inputs = input_sets(self._profile, self._layout, self._horizon, request)
        seen: Seen = take_rows(self._seen, request.slots)
        outlook = outlook_of(self._profile, self._layout, self._horizon, request, start, seen)
        return LinearForecast(start, lti.LinearMotion(inputs, models, self.bounds.process, self._layout), outlook)


@register("lti", Claim(bounds=("process", "measurement")))
def _lti(setup: Setup) -> Linear:
    return Linear(setup.profile, setup.window, setup.horizon)
