"""Method ``calibrated``: boxes around predictions, sized by the errors of earlier predictions."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import VehicleProfile
from reach_server.audit.labels import Claim
from reach_server.data.observed_range import MARGIN
from reach_server.data.regressors import RegressorSpec
from reach_server.data.window import Block, Window
from reach_server.methods.base import Outlook, Reason
from reach_server.methods.registry import Setup, register
from reach_server.methods.request import PlannedInputs, TubeRequest
from reach_server.models.conformal.limited import Bounds
from reach_server.models.conformal.predictor import Boxes, ConformalPredictor
from reach_server.models.kinematic_bounds import limits_ahead, states_limits
from reach_server.models.residual_model import NoiseBounds
from reach_server.numeric.slot_table import grow_rows
from reach_server.numeric.types import FloatArray, IndexArray
from reach_server.predicates.cut_kinds import CutMethod
from reach_server.sets.raw import RawSets
from reach_server.tube.cut_schedule import CutSchedule
from reach_server.tube.unbranched import UnbranchedTubes, box_tubes


@dataclass(frozen=True, slots=True, eq=False)
class BoxForecast:
    """Boxes that do not depend on cuts, each cut by itself."""

    start: RawSets
    motion: Boxes
    plane: tuple[int, int]
    cuts: CutMethod
    outlook: Outlook

    def ahead(self) -> tuple[FloatArray, FloatArray]:
        """See ``Forecast``."""
        center = np.concatenate([self.start.center[:, None], self.motion.center], axis=1)
        generators = np.zeros((*center.shape, center.shape[2]))
        generators[:, 1:] = self.motion.generators
        return center, generators

    def unbranched(self, rows: IndexArray, schedule: CutSchedule) -> UnbranchedTubes:
        """See ``Forecast``."""
        return box_tubes(
            self.motion.center[rows], self.motion.generators[rows], self.start.center[rows],
            self.start.generators[rows], schedule, self.plane, self.cuts,
        )  # fmt: skip


class Conformal:
    """Calibrated sets of measured states."""

    claims_measured = True
    lipschitz = None

    def __init__(self, profile: VehicleProfile, window: Window, horizon: int, *, planned: bool) -> None:
        self._profile = profile
        self._planned = planned
        self._window = window
        self._horizon = horizon
        self._limited = states_limits(profile)
        layout = RegressorSpec.of(profile)
        self.bounds = NoiseBounds.of(profile, layout)
        self._models = ConformalPredictor(profile, layout, window, horizon, planned=planned)
        self.notes: tuple[str, ...] = () if planned else ("learned driver",)
        if self._models.resolved < horizon:
            self.notes += (f"after step {self._models.resolved} few independent errors",)
        #: Glitches (V,) that have been told of.
        self._reported = np.zeros(0, dtype=np.int64)
        self.samples_needed = 1

    @property
    def frozen(self) -> bool:
        """See ``Method``."""
        return self._models.frozen

    @frozen.setter
    def frozen(self, value: bool) -> None:
        self._models.frozen = value

    def grow(self, slots: int) -> None:
        """See ``Method``."""
        self._models.grow(slots)
        self._reported = grow_rows(self._reported, slots, self._reported)

    def reset(self, slot: int) -> None:
        """See ``Method``."""
        self._models.reset(slot)
        self._reported[slot] = 0

    def learn(self, slots: IndexArray) -> None:
        """See ``Method``."""
        self._models.observe(slots)
        self._models.refit(slots)

    def glitches(self) -> list[tuple[int, int]]:
        """See ``Method``."""
        slots = np.flatnonzero(self._models.glitches[: len(self._reported)] > self._reported)
        self._reported[slots] = self._models.glitches[slots]
        return list(zip(slots.tolist(), self._window.newest(slots)[2].tolist(), strict=True))

    def missing(self, slots: IndexArray) -> NDArray[np.int64]:
        """See ``Method``."""
        return self._models.missing(slots)

    def reasons(self, slots: IndexArray, block: Block, known: PlannedInputs | None) -> list[Reason]:
        """See ``Method``."""
        unplanned = np.full(len(slots), self._planned and known is None)
        return [
            (~self._models.known(slots), "the lagged inputs and poses are not complete yet"),
            (unplanned, "no plan of the later inputs came, and the model rests on it"),
        ]

    def rank_deficient(self, slots: IndexArray) -> NDArray[np.bool_]:
        """False: the ridge keeps small what the data does not determine."""
        return np.zeros(len(slots), dtype=bool)

    def forecast(self, request: TubeRequest) -> BoxForecast:
        """See ``Method``."""
        plan = request.known.plan if request.known is not None and self._planned else None
        x = request.block.x[:, -1]
        bounds = self._bounds(request.slots, x) if self._limited else None
        boxes = self._models.predict(request.slots, plan, bounds=bounds)
        start = RawSets.zonotope(x, np.zeros((*x.shape, 0)))
        outlook = Outlook(boxes.unseen, boxes.held)
        if bounds is not None:
            slack = MARGIN * self._models.fastest(request.slots)[:, None] if bounds.noisy else 0.0
            outlook = Outlook(boxes.unseen, boxes.held, bounds.low - slack, bounds.high + slack)
        return BoxForecast(start, boxes, self._profile.position, self._profile.cuts, outlook)

    def _bounds(self, slots: IndexArray, x: FloatArray) -> Bounds:
        """Stated bounds of the measured states ahead: those of the true ones, widened by the stated noise once more."""
        ahead = limits_ahead(self._profile, x, self._horizon)
        apart = 2.0 * float(np.hypot(*ahead.error[list(self._profile.position)]))
        return Bounds(
            ahead.low - ahead.error, ahead.high + ahead.error, ahead.distance + apart,
            self._profile.noise.measurement is None,
        )  # fmt: skip


@register("calibrated", Claim(rate=True))
def _calibrated(setup: Setup) -> Conformal:
    return Conformal(setup.profile, setup.window, setup.horizon, planned=setup.planned)
