"""Method ``calibrated``: boxes around predictions, sized by how the predictions before them turned out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import VehicleProfile
from reach_server.calibrated.held import Bounds
from reach_server.calibrated.learner import Boxes, Calibrated
from reach_server.factor_sets import FactorSet
from reach_server.limits import limits_ahead, states_limits
from reach_server.methods.method import Outlook, Reason, Slots
from reach_server.model import NoiseBounds
from reach_server.plans import StraightPlan
from reach_server.regression import Layout
from reach_server.rows import with_room
from reach_server.seen import MARGIN
from reach_server.served import KnownInputs, Served
from reach_server.straight import StraightTubes, box_tubes
from reach_server.windows import Block, Floats, Window


@dataclass(frozen=True, slots=True, eq=False)
class BoxForecast:
    """Boxes that are known before, each cut by itself."""

    start: FactorSet
    motion: Boxes
    plane: tuple[int, int]
    frobenius: bool
    outlook: Outlook

    def ahead(self) -> tuple[Floats, Floats]:
        """See ``Forecast``."""
        center = np.concatenate([self.start.center[:, None], self.motion.center], axis=1)
        generators = np.zeros((*center.shape, center.shape[2]))
        generators[:, 1:] = self.motion.generators
        return center, generators

    def straight(self, rows: Slots, plan: StraightPlan) -> StraightTubes:
        """See ``Forecast``."""
        return box_tubes(
            self.motion.center[rows], self.motion.generators[rows], self.start.center[rows],
            self.start.generators[rows], plan, self.plane, "frobenius" if self.frobenius else "zonotope",
        )  # fmt: skip


class Conformal:
    """Calibrated sets, which speak about measured states."""

    claims_measured = True
    lipschitz = None

    def __init__(self, profile: VehicleProfile, window: Window, horizon: int, *, planned: bool) -> None:
        self._profile = profile
        self._planned = planned
        self._window = window
        self._horizon = horizon
        self._limited = states_limits(profile)
        layout = Layout.of(profile)
        self.bounds = NoiseBounds.of(profile, layout)
        self._models = Calibrated(profile, layout, window, horizon, planned=planned)
        self.notes: tuple[str, ...] = () if planned else ("learned driver",)
        if self._models.resolved < horizon:
            self.notes += (f"after step {self._models.resolved} few independent errors",)
        #: Glitches (V,) that have been told of.
        self._told = np.zeros(0, dtype=np.int64)
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
        self._told = with_room(self._told, slots, self._told)

    def reset(self, slot: int) -> None:
        """See ``Method``."""
        self._models.reset(slot)
        self._told[slot] = 0

    def learn(self, slots: Slots) -> None:
        """See ``Method``."""
        self._models.observe(slots)
        self._models.refit(slots)

    def glitches(self) -> list[tuple[int, int]]:
        """See ``Method``."""
        slots = np.flatnonzero(self._models.glitches[: len(self._told)] > self._told)
        self._told[slots] = self._models.glitches[slots]
        return list(zip(slots.tolist(), self._window.newest(slots)[2].tolist(), strict=True))

    def missing(self, slots: Slots) -> NDArray[np.int64]:
        """See ``Method``."""
        return self._models.missing(slots)

    def reasons(self, slots: Slots, block: Block, known: KnownInputs | None) -> list[Reason]:
        """See ``Method``."""
        unplanned = np.full(len(slots), self._planned and known is None)
        return [
            (~self._models.known(slots), "the lagged inputs and poses are not complete yet"),
            (unplanned, "no plan of the later inputs came, and the model rests on it"),
        ]

    def rank_deficient(self, slots: Slots) -> NDArray[np.bool_]:
        """None: what the data does not determine is held small."""
        return np.zeros(len(slots), dtype=bool)

    def forecast(self, served: Served) -> BoxForecast:
        """See ``Method``."""
        plan = served.known.plan if served.known is not None and self._planned else None
        x = served.block.x[:, -1]
        bounds = self._bounds(served.slots, x) if self._limited else None
        boxes = self._models.predict(served.slots, plan, bounds=bounds)
        start = FactorSet.zonotope(x, np.zeros((*x.shape, 0)))
        outlook = Outlook(boxes.unseen, boxes.held)
        if bounds is not None:
            slack = MARGIN * self._models.fastest(served.slots)[:, None] if bounds.noisy else 0.0
            outlook = Outlook(boxes.unseen, boxes.held, bounds.low - slack, bounds.high + slack)
        return BoxForecast(start, boxes, self._profile.position, self._profile.cuts == "frobenius", outlook)

    def _bounds(self, slots: Slots, x: Floats) -> Bounds:
        """Stated bounds of the measured states ahead: those of the true ones, widened by the stated noise once more."""
        ahead = limits_ahead(self._profile, x, self._horizon)
        apart = 2.0 * float(np.hypot(*ahead.error[list(self._profile.position)]))
        return Bounds(
            ahead.low - ahead.error, ahead.high + ahead.error, ahead.way + apart,
            self._profile.noise.measurement is None,
        )  # fmt: skip
