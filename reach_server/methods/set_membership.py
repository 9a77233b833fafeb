"""Guaranteed methods: least squares, bounds of the residual function, sets that are moved from step to step."""

from dataclasses import dataclass

import numpy as np

from fleet_bus.messages import VehicleProfile
from reach_server.audit.labels import Claim
from reach_server.data.input_sets import InputSets, future_inputs, limits
from reach_server.data.observed_range import Seen
from reach_server.data.regressors import RegressorSpec, lagged_inputs, unwrapped, wrap
from reach_server.data.window import Block, Window
from reach_server.methods.base import Outlook, Reason
from reach_server.methods.registry import Setup, register
from reach_server.methods.request import PlannedInputs, TubeRequest
from reach_server.models.kinematic_bounds import limits_ahead, states_limits
from reach_server.models.online import ResidualModels
from reach_server.models.residual_model import NoiseBounds
from reach_server.numeric.types import FloatArray, IndexArray
from reach_server.predicates.cut_kinds import CutMethod
from reach_server.sets import halfspace as strips
from reach_server.sets.kernels.strip import MISSED
from reach_server.sets.raw import RawSets, replace_rows
from reach_server.tube.cut_schedule import CutSchedule
from reach_server.tube.recursion import Recursion
from reach_server.tube.unbranched import UnbranchedTubes
from reach_server.tube.unbranched_kernel import recursion_tubes

#: Bounds of a prediction are moved outwards by this part of their size, against rounding.
ROUNDING = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class RecursionForecast:
    """Sets that begin at the received state and are moved by a model."""

    start: RawSets
    motion: Recursion
    plane: tuple[int, int]
    cuts: CutMethod
    outlook: Outlook

    def ahead(self) -> None:
        """Each set follows from the one before."""

    def unbranched(self, rows: IndexArray, schedule: CutSchedule) -> UnbranchedTubes:
        """See ``Forecast``."""
        return recursion_tubes(self.motion, self.start, rows, schedule, self.plane, self.cuts)


class Bounded:
    """``set_membership``, ``residual_hull`` and ``paper`` (which is ``residual_hull`` in the world frame)."""

    claims_measured = False
    frozen = False

    def __init__(
        self, profile: VehicleProfile, window: Window, horizon: int, *, membership: bool, world: bool = False
    ) -> None:
        self._profile = profile
        self._membership = membership
        self._horizon = horizon
        self._layout = RegressorSpec.of(profile, "world" if world else None)
        self.bounds = NoiseBounds.of(profile, self._layout)
        self.samples_needed = self._layout.lags + 1
        # Bounds of body-frame derivatives say nothing about the world-frame model.
        world_of_body = profile.frame == "body" and self._layout.pose is None
        self.lipschitz = None if world_of_body else profile.lipschitz
        self.notes: tuple[str, ...] = ("no Lipschitz bound",) if self.lipschitz is None else ()
        self._models = ResidualModels(
            profile, self._layout, self.bounds, self.lipschitz, window, membership=self._membership
        )
        self.grow, self.reset, self.learn = self._models.grow, self._models.reset, self._models.learn
        self.missing, self.rank_deficient = self._models.missing, self._models.rank_deficient

    def glitches(self) -> list[tuple[int, int]]:
        """None: stated bounds hold for every sample."""
        return []

    def reasons(self, slots: IndexArray, block: Block, known: PlannedInputs | None) -> list[Reason]:
        """See ``Method``."""
        return [lags_missing(block, self._layout), inputs_unlimited(self._profile, self._horizon, block, known)]

    def forecast(self, request: TubeRequest) -> RecursionForecast:
        """See ``Method``."""
        start = received(request, self._layout, self.bounds, self._models.newest(request.slots))
        inputs = input_sets(self._profile, self._layout, self._horizon, request)
        models = self._models.models(request.slots, inputs)
        motion = Recursion(inputs, models, self.bounds.process, self._layout, self._membership)
        seen = self._models.seen(request.slots)
        outlook = outlook_of(self._profile, self._layout, self._horizon, request, start, seen)
        return RecursionForecast(start, motion, self._profile.position, self._profile.cuts, outlook)


def lags_missing(block: Block, layout: RegressorSpec) -> Reason:
    """Vehicles whose lagged inputs are not known; the current one may be anything within its limits."""
    known = block.valid[:, -1].copy()
    if layout.lags:
        known &= block.linked[:, -layout.lags :].all(axis=1)
        known &= block.input_known[:, -layout.lags - 1 : -1].all(axis=1)
    return ~known, "the lagged inputs are not complete yet"


def inputs_unlimited(profile: VehicleProfile, horizon: int, block: Block, known: PlannedInputs | None) -> Reason:
    """Vehicles for which an input over the horizon is neither known nor limited."""
    needed = ~block.input_known[:, -1] | (known is None and horizon > 1)
    limited = bool(np.isfinite(np.concatenate(limits(profile))).all())
    return needed & (not limited), "no plan came, and the profile states no limits for an input"


def input_sets(profile: VehicleProfile, layout: RegressorSpec, horizon: int, request: TubeRequest) -> InputSets:
    """Sets of the inputs over the horizon."""
    u = lagged_inputs(request.block, layout)[:, -1].reshape(len(request.slots), layout.lags + 1, layout.m)
    known = request.known
    return future_inputs(
        profile, u[:, 1:], u[:, 0], request.block.input_known[:, -1], horizon,
        None if known is None else known.plan, None if known is None else known.tolerance,
    )  # fmt: skip


def outlook_of(
    profile: VehicleProfile, layout: RegressorSpec, horizon: int, request: TubeRequest, start: RawSets, seen: Seen
) -> Outlook:
    """The limits of the sets of vehicles that begin at ``start``: which regressors of the newest sample are outside the
    data (``observed_range``), and what the profile states of true states."""
    block = request.block
    z = np.concatenate([start.center[:, layout.free], lagged_inputs(block, layout)[:, -1]], axis=1)
    far = seen.outside(z)
    # An input of now that is not known may be anything within its limits.
    first, m = len(layout.free), layout.m
    far[:, first : first + m] &= block.input_known[:, -1:]
    unseen = np.zeros((len(z), layout.n + m), dtype=bool)
    for column in range(z.shape[1]):
        of = layout.free[column] if column < first else layout.n + (column - first) % m
        unseen[:, of] |= far[:, column]
    held = np.zeros((len(z), 2), dtype=bool)
    if not states_limits(profile):
        return Outlook(unseen, held)
    ahead = limits_ahead(profile, block.x[:, -1], horizon)
    return Outlook(unseen, held, ahead.low, ahead.high)


def received(request: TubeRequest, layout: RegressorSpec, bounds: NoiseBounds, newest: FloatArray) -> RawSets:
    """The true states (B, n) now: the received ones, enlarged by the noise of measurement, and cut by the interval hull
    of what was predicted for them (set-membership filtering); outer bounds. Angles among the regressors are in the turn
    of the ``newest`` state that the models hold in.

    A received state that no state of its prediction explains is taken alone; the audit reports it.
    """
    x = unwrapped(request.block, layout)[:, -1]
    if layout.pose is None:
        turns = list(layout.angles)
        x[:, turns] = newest[:, turns] + wrap(x[:, turns] - newest[:, turns])
    start = RawSets.zonotope(x, np.broadcast_to(bounds.measurement, (len(x), *bounds.measurement.shape)))
    if request.prior is None or not len(request.prior.rows):
        return start
    rows, prior = request.prior.rows, request.prior.sets
    middle, half = prior.center.copy(), np.abs(prior.generators).sum(axis=2)
    for i in layout.angles:
        middle[:, i] = x[rows, i] + wrap(middle[:, i] - x[rows, i])
    margin = ROUNDING * (np.abs(middle) + half)
    cut = strips.narrow(
        start.center[rows], start.generators[rows], np.eye(layout.n), middle - half - margin, middle + half + margin,
        np.ones(middle.shape, dtype=bool), plane=layout.plane,
    )  # fmt: skip
    held = np.flatnonzero(~(cut.acted & MISSED).any(axis=1))
    return replace_rows(start, rows[held], RawSets.zonotope(cut.center[held], cut.generators[held]))


#: What the sets rest on.
BOUNDS = Claim(bounds=("process", "measurement", "lipschitz"))


@register("set_membership", BOUNDS)
def _set_membership(setup: Setup) -> Bounded:
    return Bounded(setup.profile, setup.window, setup.horizon, membership=True)


@register("residual_hull", BOUNDS)
def _residual_hull(setup: Setup) -> Bounded:
    return Bounded(setup.profile, setup.window, setup.horizon, membership=False)


@register("paper", BOUNDS)
def _paper(setup: Setup) -> Bounded:
    return Bounded(setup.profile, setup.window, setup.horizon, membership=False, world=True)
