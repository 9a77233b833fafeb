"""Conformal prediction of the vehicles of a class from a stream of samples.

What is claimed: if the errors to come are exchangeable with those on record, a set of step h holds the next measured
state with probability at least the profile's ``confidence`` [VGS05, chapter 2]. For the newest sample k with features
φ_h (``spec``):

    d_{k+h} ≈ M_h φ_h                                  increment in the vehicle's own frame (or the world's)
    θ_{h+1} = θ_h + d^θ ,  p_{h+1} = p_h + R(θ_h) d^p     centre of step h + 1
    E_h = (R(-θ_k)(p_{k+h} - p̂_h), rest)               error in the frame of sample k
    a_ih                                               its expected size (``scale``)
    ζ_h = max_i |E_ih| / a_ih                          score
    s_h = the ceil((W+1) confidence)-th smallest of the W scores ζ_h that the window shows
    set: p̂_h ± R(θ_k) diag(s_h a_h)

Predictions are scored h samples later. What the window shows of the time before there was a model, out-of-fold errors
say: no datum judges a model that it was fitted to, though errors of neighbouring samples overlap at the borders of
folds.
"""

import zlib
from dataclasses import dataclass

import numpy as np

from fleet_bus.errors import UsageError
from fleet_bus.messages import VehicleProfile
from reach_server.data.readiness import samples_missing
from reach_server.data.regressors import RegressorSpec
from reach_server.data.window import Window
from reach_server.models.conformal import fit as fitting
from reach_server.models.conformal.limited import Bounds
from reach_server.models.conformal.predict import forecast, known_now, observe
from reach_server.models.conformal.scale import resize
from reach_server.models.conformal.spec import FeatureSpec, owners
from reach_server.models.conformal.state import empty, grown
from reach_server.numeric.slot_table import grow_rows
from reach_server.numeric.types import BoolArray, FloatArray, IndexArray, IntArray
from reach_server.sets.raw import RawSets

#: A model is solved again after this many samples.
REFIT_EVERY = 10
#: Data per unknown below which a model is not worth publishing from.
DATA_PER_UNKNOWN = 2
#: Scores of a full window that must lie beyond the margin.
LEAST_BEYOND = 3


@dataclass(frozen=True, slots=True, eq=False)
class Boxes:
    """Calibrated boxes, a ``Motion``: each step has a box of its own, whatever cut the one before. It holds the state
    that will be measured at the rate of the profile's confidence, under the assumptions of mathematics, 5.2 and 5.3.

    ``center`` (B, N, n); ``half`` (B, N, n) half-widths in the frame of the newest sample; ``generators`` (B, N, n, n)
    the same, turned to the world. ``unseen`` (B, n + m): states and inputs of which what enters the model lies outside
    the data, so that nothing is known of the rate. ``held`` (B, 2): a box was cut by stated bounds, by observed ones.
    """

    center: FloatArray
    half: FloatArray
    generators: FloatArray
    unseen: BoolArray
    held: BoolArray

    @property
    def horizon(self) -> int:
        """Steps N."""
        steps: int = self.center.shape[1]
        return steps

    def begin(self, start: RawSets, vehicle: IndexArray) -> RawSets:
        """The sets (R, n) of the vehicles ``vehicle`` (R,) as they are."""
        return start

    def advance(self, sets: RawSets, k: int, vehicle: IndexArray) -> tuple[RawSets, BoolArray]:
        """The boxes (R, n) after step ``k`` (from 0) of the vehicles ``vehicle`` (R,)."""
        return RawSets.zonotope(self.center[vehicle, k], self.generators[vehicle, k]), np.zeros(len(vehicle), bool)


def least_scores(confidence: float) -> int:
    """Number of scores below which the rank statistic of this confidence does not exist."""
    least = int(np.ceil(confidence / (1 - confidence) - 1e-9))
    return least


def scores_beyond(window: int, confidence: float) -> int:
    """How many of ``window`` scores lie beyond the margin: those above the ceil((W + 1) confidence)-th smallest."""
    return max(window - int(np.ceil((window + 1) * confidence - 1e-9)), 0)


def least_window(confidence: float) -> int:
    """The shortest window that leaves ``LEAST_BEYOND`` scores beyond the margin: the least W with
    (1 - confidence)(W + 1) ≥ ``LEAST_BEYOND`` + 1."""
    least = max(int((LEAST_BEYOND + 1) / (1 - confidence)) - 2, 1)
    while scores_beyond(least, confidence) < LEAST_BEYOND:
        least += 1
    return least


class ConformalPredictor:
    """Models, sizes and margins of the vehicles of a class, by slot; their samples are in ``window``.

    Sets hold the next measured states at a rate [VGS05], no set is guaranteed (mathematics, section 5). ``slots`` (B,)
    name the vehicles asked about. Per tick, in this order: ``observe``, ``refit``, ``predict``. Equal data gives equal
    sets, whatever the slot: what a vehicle gets depends on its own samples, and when it is refitted on a checksum of
    them, which spreads the work.

    Args:
        profile: the class; ``margin: tube`` makes the confidence one of whole tubes.
        layout: frame and lags.
        window: where the samples come from.
        horizon: steps N.
        planned: later inputs are known when sets are asked for.

    Raises ``UsageError`` where the window cannot resolve the confidence, or holds too few data for the model.
    """

    def __init__(
        self, profile: VehicleProfile, layout: RegressorSpec, window: Window, horizon: int, *, planned: bool = False
    ) -> None:
        self._spec = FeatureSpec.of(profile, layout, horizon, planned=planned)
        self._confidence = profile.confidence
        self._window = window
        self._plane = np.isin(np.arange(layout.n), profile.position)
        self._span = profile.window
        #: The least number of data for a model.
        self.least = max(least_scores(profile.confidence), DATA_PER_UNKNOWN * self._spec.total)
        self._capacity = window.size - self._spec.reach - horizon - fitting.SPARE
        self._check(profile)
        self._owner = owners(profile, layout, self._spec)
        self._model, self._record, self._pending = empty(
            self._spec, window.size, self._spec.groups, tube=profile.margin == "tube"
        )
        self._revision = np.zeros(0, dtype=np.int64)
        self._outdated = np.zeros(0, dtype=bool)
        self._solved = np.zeros(0, dtype=np.int64)
        self._renewal = np.zeros(0, dtype=np.int64)
        self._chosen_on = np.zeros(0, dtype=np.int64)
        self._checksum = np.zeros(0, dtype=np.int64)
        #: True: what is known stays as it is; nothing is learned, no margin moves.
        self.frozen = False

    def _check(self, profile: VehicleProfile) -> None:
        beyond = scores_beyond(profile.window, profile.confidence)
        if beyond < LEAST_BEYOND:
            raise UsageError(
                f"confidence {profile.confidence:g} leaves {beyond} of the {profile.window} scores of a window "
                f"outside the sets, too few to tell: at least {LEAST_BEYOND} are needed; make the window "
                f"{least_window(profile.confidence)} or longer, or the confidence smaller"
            )
        if self._capacity < self.least:
            raise UsageError(
                f"a calibrated model with {self._spec.total} features and confidence {profile.confidence:g} needs "
                f"{self.least} data, there is room for {self._capacity}: make the window "
                f"{profile.window + self.least - self._capacity} or "
                "longer, or let fewer inputs lag"
            )

    @property
    def resolved(self) -> int:
        """Steps h whose margin rests on enough errors that do not overlap: of as many coming checks as the window is
        long, 3 h are expected to miss."""
        return min(self._spec.horizon, int((1 - self._confidence) * self._span / LEAST_BEYOND + 1e-9))

    @property
    def glitches(self) -> IntArray:
        """Samples (V,) found to be measurement glitches, by slot."""
        return self._pending.glitches

    @property
    def bytes_per_vehicle(self) -> int:
        """Memory of one vehicle, its window not counted."""
        return sum(int(np.prod(a.shape[1:])) * a.itemsize for a in (*self._model, *self._record, *self._pending))

    def grow(self, slots: int) -> None:
        """Make room for ``slots`` vehicles."""
        self._model, self._record = grown(self._model, slots), grown(self._record, slots)
        self._pending = grown(self._pending, slots)
        for name in ("_revision", "_outdated", "_solved", "_renewal", "_chosen_on", "_checksum"):
            array = getattr(self, name)
            setattr(self, name, grow_rows(array, slots, array))

    def reset(self, slot: int) -> None:
        """Forget what was learned of one vehicle."""
        for array in (*self._model, *self._record, *self._pending):
            array[slot] = 0
        self._pending.number[slot] = self._pending.last_number[slot] = -1
        self._revision[slot] = self._window.revision[slot]
        self._outdated[slot] = False

    def observe(self, slots: IndexArray) -> None:
        """Score the predictions of some vehicles by the samples that have come since; marks glitches in the window."""
        if self.frozen or not len(slots):
            return
        count, revision = self._window.count, self._window.revision
        moved = revision[slots] != self._revision[slots]
        if moved.any():
            # Late samples have moved the others: nothing on record stands where it stood.
            self._outdated[slots[moved]] = True
            self._revision[slots[moved]] = revision[slots[moved]]
        live = slots[~self._outdated[slots]] if self._outdated[slots].any() else slots
        gate = np.empty(len(live), dtype=np.int64)
        observe(self._window.arrays(), count, live, self._record, self._pending, self._spec, self._confidence, gate)
        if (found := gate >= 0).any():
            self._window.gate(live[found], gate[found])
            self._revision[live[found]] = revision[live[found]]
            self._renewal[live[found]] = count[live[found]]

    def refit(self, slots: IndexArray) -> None:
        """Fit where enough new samples have come, and where there are enough for the first time."""
        new = ~self._pending.fitted[slots]
        if not self.frozen:
            new |= self._outdated[slots]
        if new.any():
            self._begin(slots[new])
        if self.frozen or new.all():
            return
        slots = slots[~new]
        slots = slots[self._window.count[slots] >= self._solved[slots] + REFIT_EVERY]
        if not len(slots):
            return
        count = self._window.count[slots]
        # What leaves the sums must still be there to be computed.
        lost = self._model.oldest[slots] < count - self._window.size + self._spec.reach
        renewed = lost | (count >= self._renewal[slots]) | ~np.isfinite(self._record.margin[slots]).all(axis=(1, 2))
        if not renewed.all():
            carried = slots[~renewed]
            outgrown = np.empty(len(carried), dtype=bool)
            fitting.carry_on(self._window.arrays(), self._window.count, carried, self._model, self._spec, outgrown)
            self._solved[carried] = self._on_grid(carried)
            self._renewal[carried[outgrown]] = self._window.count[carried[outgrown]]
        if renewed.any():
            self._renew(slots[renewed])

    def _renew(self, slots: IndexArray) -> None:
        """Refit vehicles that have a model; those with too few data left lose it."""
        poor = self._data(slots) < self.least
        self._pending.fitted[slots[poor]] = False
        slots = slots[~poor]
        # The ridge is chosen anew until half of a full window has been seen at once, and the record filled up until
        # there are enough predictions that turned out.
        few = self._record.known[slots].min(axis=(1, 2)) < min(
            LEAST_BEYOND / (1 - self._confidence), self._capacity // 2
        )
        self._fit(slots, few | (self._chosen_on[slots] < self._capacity // 2))
        self._renewal[slots] = self._window.count[slots] + self._period(slots)

    def _begin(self, slots: IndexArray) -> None:
        """Fit the first models of some vehicles, or the first after their windows have changed as a whole."""
        data = self._data(slots)
        self._pending.fitted[slots] = False
        slots = slots[data >= self.least]
        if not len(slots):
            return
        for slot in slots.tolist():
            self._record.codes[slot] = 0
            self._model.scale[slot] = 0.0
            self._pending.number[slot] = self._pending.last_number[slot] = -1
        newest = self._window.arrays().x[slots, (self._window.count[slots] - 1) % self._window.size]
        self._checksum[slots] = [zlib.crc32(state.tobytes()) for state in newest]
        self._pending.seen[slots] = self._window.count[slots]
        self._fit(slots, np.ones(len(slots), dtype=bool))
        self._pending.fitted[slots] = True
        self._outdated[slots] = False
        period = self._period(slots)
        self._renewal[slots] = self._window.count[slots] + period + self._checksum[slots] % period

    def _fit(self, slots: IndexArray, fill: BoolArray) -> None:
        """Models and sizes of some vehicles from all of their windows."""
        samples, count = self._window.arrays(), self._window.count
        fitting.fit(samples, count, slots, fill, self._model, self._record, self._spec)
        resize(samples, count, slots, self._record, self._spec, self._plane, self._confidence)
        self._chosen_on[slots] = np.where(fill, self._model.data[slots], self._chosen_on[slots])
        self._solved[slots] = self._on_grid(slots)

    def _on_grid(self, slots: IndexArray) -> IntArray:
        """The last number of a sample up to now at which the vehicles (B,) are due to be solved."""
        count = self._window.count[slots]
        on_grid: IntArray = count - (count + self._checksum[slots]) % REFIT_EVERY
        return on_grid

    def _period(self, slots: IndexArray) -> IntArray:
        """Samples (B,) after which a model is fitted from scratch: a window, after which the record holds only scores
        of real predictions; half as many as there were while there were few."""
        data = self._model.data[slots]
        return np.where(data < self._capacity // 2, np.maximum(data, self.least) // 2, self._span)

    def _data(self, slots: IndexArray) -> IntArray:
        """How many data the windows (B,) hold."""
        data = np.empty(len(slots), dtype=np.int64)
        fitting.count_usable(self._window.arrays(), self._window.count, slots, self._spec, data)
        return data

    def ready(self, slots: IndexArray) -> BoolArray:
        """Which vehicles (B,) have a model, and scores enough for their margins."""
        return np.asarray(self._pending.fitted[slots] & np.isfinite(self._record.margin[slots]).all(axis=(1, 2)))

    def known(self, slots: IndexArray) -> BoolArray:
        """Of which vehicles (B,) the newest sample has all that its features look back to."""
        complete = np.empty(len(slots), dtype=bool)
        known_now(self._window.arrays(), self._window.count, slots, self._spec, complete)
        return complete

    def missing(self, slots: IndexArray) -> IntArray:
        """How many samples more (B,) the vehicles need if none is lost; 0 where they have a model and margins."""
        missing = np.zeros(len(slots), dtype=np.int64)
        pending = np.flatnonzero(~self.ready(slots))
        if len(pending):
            slots = slots[pending]
            # A sample is a datum when it has a past of ``reach`` samples and a future of N.
            links = self._spec.reach + self._spec.horizon
            missing[pending] = np.maximum(samples_missing(self._window, slots, self._data(slots), self.least, links), 1)
        return missing

    def fastest(self, slots: IndexArray) -> FloatArray:
        """The greatest change (B, n) of each state from one sample to the next that the windows of vehicles show."""
        return np.asarray(self._record.fastest[slots])

    def predict(
        self, slots: IndexArray, plan: FloatArray | None, remember: bool = True, bounds: Bounds | None = None
    ) -> Boxes:
        """Sets of vehicles (B,) that are ``ready`` and ``known``, from their newest samples.

        ``plan`` (B, N - 1, m) are the later inputs, where they enter the model. With ``remember`` the predictions are
        scored when the samples come. ``bounds`` are what the profile states of the states ahead. Raises ``UsageError``
        where a plan is needed and none is given.
        """
        spec = self._spec
        if spec.planned and plan is None:
            raise UsageError("the later inputs enter the model: give a plan")
        later = np.zeros((0, 0, spec.m)) if plan is None else np.ascontiguousarray(plan, dtype=np.float64)
        center, half = (np.empty((len(slots), spec.horizon, spec.n)) for _ in range(2))
        generators = np.zeros((len(slots), spec.horizon, spec.n, spec.n))
        unseen = np.zeros((len(slots), spec.n + spec.m), dtype=bool)
        held = np.zeros((len(slots), 2), dtype=bool)
        if bounds is None:
            bounds = Bounds.none(len(slots), spec.horizon, spec.n)
        samples, count = self._window.arrays(), self._window.count
        forecast(
            samples, count, slots, later, self._model, self._record, self._pending, spec, remember, bounds,
            self._owner, center, half, generators, unseen, held,
        )  # fmt: skip
        return Boxes(center, half, generators, unseen, held)
