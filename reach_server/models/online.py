"""Least-squares models of the vehicles of a class, by slot: they follow the window and are fitted again now and then.

A model is fitted again after ``REFIT_EVERY`` samples; in between, the hull of the residuals and the noise set are
extended by what enters, so that they hold for all data (any M is sound when the bounds are those of that same M; data
that has left a window remains true). Which sample it is depends on the data of the vehicle alone: equal data gives
equal models, and the fits of different vehicles are spread over the ticks.

The interval between two samples may be off by the profile's tolerance. Data is not scaled by it: what that does to a
transition is part of the process noise that the profile states.
"""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Lipschitz, VehicleProfile
from reach_server.data.input_sets import InputSets
from reach_server.data.observed_range import Seen, ranges_many
from reach_server.data.readiness import samples_missing
from reach_server.data.regressors import RegressorSpec
from reach_server.data.reservoir import Reservoir
from reach_server.data.window import Window
from reach_server.models import recursive_least_squares as rls
from reach_server.models.cholesky import solve_many
from reach_server.models.data_selection import Data, choose_many
from reach_server.models.recursive_least_squares import KernelSpec, StreamingMoments
from reach_server.models.residual_model import (
    Model,
    NoiseBounds,
    noise_set,
    regressor_noise,
    residual_slope,
    solve,
    thin_directions,
)
from reach_server.numeric.slot_table import grow_rows
from reach_server.numeric.types import FloatArray, IndexArray

#: A vehicle's model is fitted again after this many new samples.
REFIT_EVERY = 10
#: Data per unknown below which a model is not worth publishing from.
DATA_PER_UNKNOWN = 2


@dataclass(slots=True, eq=False)
class _Store:
    """The models in use, by slot: as in ``Model``, and the ranges ``low`` and ``high`` (V, p) of the regressors."""

    matrix: FloatArray
    noise: FloatArray
    slope: FloatArray
    directions: FloatArray
    rank_deficient: NDArray[np.bool_]
    fitted: NDArray[np.bool_]
    low: FloatArray
    high: FloatArray


class ResidualModels:
    """Least-squares models with bounded residuals of the vehicles of a class.

    Args:
        profile: the class.
        layout: in which frame, with which regressors.
        bounds, lipschitz: what the profile states, for that layout.
        window: the samples; ``learn`` follows it.
        membership: data is chosen for set membership, else for the residual hull.
    """

    def __init__(
        self,
        profile: VehicleProfile,
        layout: RegressorSpec,
        bounds: NoiseBounds,
        lipschitz: Lipschitz | None,
        window: Window,
        *,
        membership: bool,
    ) -> None:
        self._layout = layout
        self._bounds = bounds
        self._lipschitz = lipschitz
        self._window = window
        self._membership = membership and lipschitz is not None
        self._nearest = profile.nearest if lipschitz is not None else 0
        p, n = layout.regressors, layout.n
        exact = np.zeros(p + n, dtype=bool)
        if layout.pose is not None:
            exact[[p + layout.pose[0], p + layout.pose[1]]] = True
        self._spec = KernelSpec(
            np.array(layout.free, dtype=np.int64), np.array(layout.angles, dtype=np.int64), layout.pose or (-1, -1, -1),
            layout.lags, exact,
        )  # fmt: skip
        self._reservoir = Reservoir(profile.reservoir, p, n)
        capacity = window.size + profile.reservoir
        whole: tuple[int, ...] = ()
        shapes = (
            ((p, capacity), float), ((n, capacity), float), ((capacity,), bool), ((n,), float),
            (whole, np.int64), (whole, np.int64), (whole, np.int64),
            ((p + n,), float), ((1 + p, 1 + p + n), float), ((p,), float), (whole, np.int64),
            ((n,), float), ((n,), float), ((p + n,), float),
        )  # fmt: skip
        self._stream = StreamingMoments(*(np.zeros((0, *shape), dtype=kind) for shape, kind in shapes))
        self._revision = np.zeros(0, dtype=np.int64)
        nothing = np.zeros((0, n, 1 + p))
        noise = noise_set(nothing, np.zeros((0, p + n)), layout, bounds)
        self._store = _Store(
            nothing,
            noise,
            nothing[..., 1:],
            thin_directions(noise),
            np.zeros(0, dtype=bool),
            np.zeros(0, dtype=bool),
            np.zeros((0, p)),
            np.zeros((0, p)),
        )

    def grow(self, slots: int) -> None:
        """Make room for ``slots`` vehicles."""
        self._stream = StreamingMoments(*(grow_rows(array, slots, array) for array in self._stream))
        self._reservoir.grow(slots)
        self._revision = grow_rows(self._revision, slots, self._revision)
        for field in fields(self._store):
            array = getattr(self._store, field.name)
            setattr(self._store, field.name, grow_rows(array, slots, array))

    def reset(self, slot: int) -> None:
        """Forget the data and the model of one vehicle."""
        # What is not data either: about which center moments are taken, and the largest regressors.
        for array in self._stream:
            array[slot] = 0
        self._reservoir.clear(slot)
        self._store.fitted[slot] = False

    def ready(self, slots: IndexArray) -> NDArray[np.bool_]:
        """Which vehicles (B,) have a model."""
        return np.asarray(self._store.fitted[slots])

    def missing(self, slots: IndexArray) -> NDArray[np.int64]:
        """How many samples more some vehicles (B,) need at least before they have a model; 0 where they have one."""
        lacking = samples_missing(self._window, slots, self._stream.data[slots], self._least, self._layout.lags + 1)
        return np.asarray(np.where(self._store.fitted[slots], 0, np.maximum(lacking, 1)))

    @property
    def _least(self) -> int:
        return DATA_PER_UNKNOWN * (1 + self._layout.regressors)

    def rank_deficient(self, slots: IndexArray) -> NDArray[np.bool_]:
        """Of which vehicles (B,) the data does not determine the model."""
        return np.asarray(self._store.rank_deficient[slots])

    def newest(self, slots: IndexArray) -> FloatArray:
        """The newest states (B, n) in the data, angles in the turn that the models hold in."""
        return np.asarray(self._stream.newest[slots])

    def seen(self, slots: IndexArray) -> Seen:
        """Ranges of the regressors in the windows of some vehicles (B,)."""
        return Seen(self._store.low[slots], self._store.high[slots])

    def learn(self, slots: IndexArray) -> None:
        """Update some vehicles (B,), each named once, with their new samples, and fit those that are due."""
        slots = slots.astype(np.int64)
        changed = slots[self._revision[slots] != self._window.revision[slots]]
        for slot in changed.tolist():
            rls.forget(self._stream, slot, 0)
        self._revision[changed] = self._window.revision[changed]
        grew = np.zeros(len(slots), dtype=bool)
        p, n, retains = self._layout.regressors, self._layout.n, self._reservoir.size > 0
        # Of what came, a window holds no more than its size.
        new = np.minimum(self._window.count[slots] - self._stream.processed[slots], self._window.size)
        evicted = np.empty((int(new.sum()) if retains else 0, 1 + p + n))
        window = self._window
        count = rls.update(
            slots, window.arrays(), window.count, self._spec, self._stream, self._store.matrix, grew, evicted
        )
        if count:
            self._offer(evicted[:count])
        fitted = self._store.fitted[slots]
        if len(wider := slots[grew & fitted]):
            self._store.noise[wider] = noise_set(
                self._store.matrix[wider], self._stream.largest[wider], self._layout, self._bounds
            )
        due = (self._stream.data[slots] >= self._least) & (~fitted | (self._stream.since_fit[slots] >= REFIT_EVERY))
        if due.any():
            self._fit(slots[due])

    def _offer(self, evicted: FloatArray) -> None:
        """Offer evicted data to the reservoir; it counts from the next fit on."""
        slots, p = evicted[:, 0].astype(np.intp), self._layout.regressors
        moments = self._stream.moments[slots]
        mean = moments[:, 0, 1 : 1 + p] / np.maximum(moments[:, :1, 0], 1.0)
        square = np.einsum("bcc->bc", moments[:, 1:, 1 : 1 + p]) / np.maximum(moments[:, :1, 0], 1.0)
        scale = np.sqrt(np.maximum(square - mean**2, 0.0))
        self._reservoir.offer(slots, evicted[:, 1 : 1 + p], evicted[:, 1 + p :], scale)

    def _recall(self, slots: NDArray[np.int64]) -> None:
        """Add the rows of the reservoir to the data of some vehicles."""
        z, y, held = self._reservoir.rows(slots)
        size = self._window.size
        self._stream.z[slots, :, size:] = np.swapaxes(z, 1, 2)
        self._stream.y[slots, :, size:] = np.swapaxes(y, 1, 2)
        self._stream.valid[slots, size:] = np.arange(self._reservoir.size) < held[:, None]

    def _fit(self, slots: NDArray[np.int64]) -> None:
        """Fit the models of some vehicles anew."""
        p, n, store = self._layout.regressors, self._layout.n, self._store
        covariance, cross = np.empty((len(slots), p, p)), np.empty((len(slots), p, n))
        means, matrix = np.empty((len(slots), p + n)), np.empty((len(slots), n, 1 + p))
        rls.covariances(slots, self._stream, self._window.size, covariance, cross, means)
        doubtful = ~solve_many(covariance, cross, means, matrix)
        store.rank_deficient[slots] = False
        if doubtful.any():
            matrix[doubtful], store.rank_deficient[slots[doubtful]] = solve(
                covariance[doubtful], cross[doubtful], means[doubtful, :p], means[doubtful, p:]
            )
        if self._reservoir.size:
            self._recall(slots)
        rls.bound_many(slots, self._stream, matrix, self._spec)
        noise = noise_set(matrix, self._stream.largest[slots], self._layout, self._bounds)
        store.matrix[slots], store.noise[slots] = matrix, noise
        store.slope[slots] = residual_slope(matrix, self._lipschitz)
        store.directions[slots] = thin_directions(noise)
        new = slots[~store.fitted[slots]]
        phase = self._phase(new)
        self._stream.since_fit[new] = phase % REFIT_EVERY
        self._stream.age[new] = phase % self._window.size
        store.fitted[slots] = True
        ranges_many(slots, self._stream.z, self._stream.valid, store.low, store.high)

    def _phase(self, slots: NDArray[np.int64]) -> NDArray[np.int64]:
        """Pseudo-random numbers (B,) that depend only on the data of vehicles just fitted."""
        bits = self._stream.low[slots].view(np.uint64)
        mixed = (bits * np.uint64(0x9E3779B97F4A7C15)).sum(axis=1, dtype=np.uint64)
        return np.asarray(mixed >> np.uint64(33), dtype=np.int64)

    def models(self, slots: IndexArray, inputs: InputSets) -> Model:
        """The models of some vehicles (B,) that are ready, each with the data that binds along the path from its newest
        state under the ``inputs``."""
        slots, store = slots.astype(np.int64), self._store
        p, n, count = self._layout.regressors, self._layout.n, len(slots)
        found = Model(
            store.matrix[slots], np.zeros((count, p, self._nearest)), np.zeros((count, n, self._nearest)),
            np.zeros(count, dtype=np.int64), self._stream.low[slots], self._stream.high[slots], store.noise[slots],
            store.slope[slots], regressor_noise(self._layout, self._bounds, count), store.directions[slots],
            store.rank_deficient[slots], self._stream.newest[slots],
        )  # fmt: skip
        choose_many(
            Data(self._stream.z, self._stream.y, self._stream.valid), slots, found.arrays(), self._membership,
            self._spec.free, self._layout.pose is not None, found.newest, *_contiguous(inputs.past, inputs.center),
        )  # fmt: skip
        return found


def _contiguous(*arrays: Any) -> tuple[FloatArray, ...]:
    return tuple(np.ascontiguousarray(array) for array in arrays)
