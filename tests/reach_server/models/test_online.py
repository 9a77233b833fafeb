"""Models that follow a stream of samples: their data, moments and hulls against what all of it says at once."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fleet_bus.messages import StateFlag, VehicleProfile, parse_profile
from reach_server.data.input_sets import InputSets
from reach_server.data.regressors import RegressorSpec, transitions
from reach_server.data.window import Block, SampleBatch, Window
from reach_server.models.online import REFIT_EVERY, ResidualModels
from reach_server.models.residual_model import Model, NoiseBounds, apply, residual_set
from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray
from reach_server.sets.raw import RawSets
from reach_server.tube.recursion import Recursion
from tests.reach_server.drives import LAYOUT, PROFILE, START, SVEA, dynamics, history, samples_of
from tests.reach_server.ugly import moderate
from vehicle_agent.svea import SPEED_COVERED

FRAMES = pytest.mark.parametrize("frame", ["body", "world"])


class Stream:
    """A window and the models that follow it."""

    def __init__(
        self, vehicles: int = 1, *, frame: str = "body", size: int = 80, membership: bool = True, **changes: object
    ) -> None:
        fields = PROFILE.model_dump(by_alias=True)
        self.profile = VehicleProfile.model_validate(fields | {"window": size} | changes)
        self.layout = RegressorSpec.of(self.profile, frame)
        self.bounds = NoiseBounds.of(self.profile, self.layout)
        self.window = Window(self.profile, size)
        self.window.grow(vehicles)
        lipschitz = self.profile.lipschitz if frame == "body" else None
        self.models = ResidualModels(
            self.profile, self.layout, self.bounds, lipschitz, self.window, membership=membership
        )
        self.models.grow(vehicles)
        self.slots = np.arange(vehicles)

    def feed(self, batch: SampleBatch, *, learn: bool = True) -> None:
        self.window.append(batch)
        if learn:
            self.models.learn(np.unique(batch.vehicle))

    def inputs(self, steps: int = 5) -> InputSets:
        """Later inputs that stay near zero."""
        count, m = len(self.slots), self.layout.m
        zero = np.zeros((count, steps, m))
        return InputSets(np.zeros((count, self.layout.lags, m)), zero, zero + 0.05)

    def model(self) -> Model:
        """The models that tubes are computed with."""
        return self.models.models(self.slots, self.inputs())

    def data(self, slot: int = 0) -> tuple[FloatArray, FloatArray]:
        """Regressors and targets that the models hold, oldest first."""
        size, count = self.window.size, int(self.window.count[slot])
        moments = self.models._stream
        indices = np.arange(count - min(count, size), count) % size
        indices = indices[moments.valid[slot, indices]]
        return moments.z[slot][:, indices].T, moments.y[slot][:, indices].T


def expected(stream: Stream, slot: int = 0) -> tuple[FloatArray, FloatArray]:
    """The same from the whole window at once."""
    block: Block = stream.window.block(np.array([slot]))
    data = transitions(block, stream.layout)
    columns = stream.window.arrays()
    order = (stream.window.count[slot] + np.arange(stream.window.size)) % stream.window.size
    gated = columns.gated[slot, order]
    usable = data.usable[0].copy()
    usable[:-1] &= ~gated[:-1] & ~gated[1:]
    return data.z[0, usable], data.target[0, usable]


def assert_equal_data(
    found: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray], stream: Stream
) -> None:
    """The same data; absolute headings may differ by whole turns, of a regressor and its target alike."""
    (z, y), (z_other, y_other) = found, other
    assert z.shape == z_other.shape
    dz, dy = z - z_other, y - y_other
    if stream.layout.pose is None:
        np.testing.assert_allclose(dz[:, 2], dy[:, 2], atol=1e-9)
        np.testing.assert_allclose(np.exp(1j * dz[:, 2]), 1.0, atol=1e-9)
        dz[:, 2] = dy[:, 2] = 0.0
    np.testing.assert_allclose(dz, 0.0, atol=1e-12)
    np.testing.assert_allclose(dy, 0.0, atol=1e-12)


def ragged(seed: int, count: int, slot: int = 0) -> SampleBatch:
    """Samples of a car that turns a lot, with gaps, new trajectories and inputs that are not known."""
    rng = np.random.default_rng(seed)
    seq = np.cumsum(1 + (rng.random(count) < 0.04))
    x = rng.normal(size=(count, 4)) * 0.02
    x[:, 2] = np.cumsum(rng.uniform(-0.3, 0.6, count))
    x[:, 2] = np.remainder(x[:, 2] + np.pi, 2 * np.pi) - np.pi
    flags = np.where(rng.random(count) < 0.03, int(StateFlag.NEW_TRAJECTORY), 0)
    flags |= np.where(rng.random(count) < 0.05, int(StateFlag.INPUT_MISSING), 0)
    return SampleBatch(
        np.full(count, slot, dtype=np.intp), np.ones(count, dtype=np.uint64), seq.astype(np.uint64),
        START + seq * SVEA.dt_ns, flags.astype(np.uint32), x, rng.uniform(-0.5, 0.5, (count, 2)),
    )  # fmt: skip


@moderate
@given(st.integers(0, 2**32 - 1), st.sampled_from(["body", "world"]))
@pytest.mark.slow
def test_the_data_is_that_of_the_window_however_it_came(seed: int, frame: str) -> None:
    stream, rng = Stream(frame=frame), np.random.default_rng(seed)
    batch = ragged(seed, 230)
    order = np.arange(230)
    # Some come late, some twice, and a glitch is gated.
    late = rng.integers(20, 220)
    order[[late, late + 3]] = order[[late + 3, late]]
    start = 0
    while start < 230:
        step = int(rng.integers(1, 12))
        stream.feed(batch.take(order[start : start + step]), learn=bool(rng.random() < 0.6))
        start += step
        if rng.random() < 0.1:
            stream.window.gate(stream.slots, rng.integers(0, min(start, 80), 1))
    stream.models.learn(stream.slots)
    assert_equal_data(stream.data(), expected(stream), stream)


@FRAMES
def test_moments_and_hull_stay_those_of_the_data(frame: str) -> None:
    stream, batch = Stream(frame=frame), samples_of(history(2), 0, 420)
    for k in range(420):
        stream.feed(batch.take(np.array([k])))
        if k < 60 or k % 7:
            continue
        z, y = stream.data()
        moments, model = stream.models._stream, stream.model()
        middle = moments.center[0]
        both = np.column_stack([np.ones(len(z)), np.concatenate([z, y], axis=1) - middle])
        exact = both[:, : 1 + z.shape[1]].T @ both
        np.testing.assert_allclose(moments.moments[0], exact, atol=1e-9 * np.abs(exact).max())
        residual = y - apply(model.matrix[:1], z[None])[0]
        assert (model.low[0] <= residual.min(axis=0) + 1e-12).all()
        assert (model.high[0] >= residual.max(axis=0) - 1e-12).all()
        assert (moments.largest[0] >= np.abs(np.concatenate([z, y], axis=1)).max(axis=0)).all()
        assert moments.data[0] == len(z)


@FRAMES
def test_the_fit_is_that_of_least_squares(frame: str) -> None:
    stream = Stream(frame=frame, size=200)
    stream.feed(samples_of(history(3), 0, 300))
    z, y = stream.data()
    design = np.column_stack([np.ones(len(z)), z])
    best = np.linalg.lstsq(design, y, rcond=None)[0]
    found = stream.model().matrix[0]
    np.testing.assert_allclose(design @ found.T, design @ best, atol=1e-7 * np.abs(y).max())
    assert not stream.models.rank_deficient(stream.slots).any()


def test_models_are_fitted_again_after_some_samples_of_the_vehicle() -> None:
    stream, batch = Stream(), samples_of(history(1), 0, 200)
    fits = []
    for k in range(200):
        before = stream.model().matrix
        stream.feed(batch.take(np.array([k])))
        if not np.array_equal(before, stream.model().matrix):
            fits.append(k)
    assert set(np.diff(fits[1:]).tolist()) == {REFIT_EVERY}
    assert 0 < fits[1] - fits[0] <= REFIT_EVERY


def test_what_is_missing_is_told_and_comes_true() -> None:
    stream, batch = Stream(), samples_of(history(1), 0, 60)
    told = int(stream.models.missing(stream.slots)[0])
    assert told == 2 * 8 + LAYOUT.lags + 1
    for k in range(told):
        assert not stream.models.ready(stream.slots).any()
        assert int(stream.models.missing(stream.slots)[0]) == told - k
        stream.feed(batch.take(np.array([k])))
    assert stream.models.ready(stream.slots).all()
    assert not stream.models.missing(stream.slots).any()
    stream.models.reset(0)
    assert not stream.models.ready(stream.slots).any()


def test_a_parked_car_is_told_to_be_rank_deficient_and_heals() -> None:
    stream, batch = Stream(), samples_of(history(1), 0, 300)
    rng = np.random.default_rng(0)
    parked = (np.arange(300) >= 60) & (np.arange(300) < 180)
    batch.u[parked] = 0.0
    batch.x[parked] = batch.x[60] + rng.uniform(-1, 1, (parked.sum(), 4)) * 1e-3
    told = []
    for k in range(300):
        stream.feed(batch.take(np.array([k])))
        told.append(bool((stream.models.ready(stream.slots) & stream.models.rank_deficient(stream.slots))[0]))
    assert not told[58]
    assert told[178]
    assert not told[-1]


def test_equal_data_gives_equal_models_whatever_is_beside_it() -> None:
    alone, beside = Stream(1), Stream(5)
    for k in range(200):
        alone.feed(samples_of(history(1), k, k + 1))
        batches = [samples_of(history(1), k, k + 1, slot) for slot in (1, 4)]
        # Others with data of their own, one of which begins late.
        batches += [samples_of(history(2), k, k + 1, 0), samples_of(history(3), k, k + 1, 3)]
        if k > 77:
            batches.append(samples_of(history(4), k, k + 1, 2))
        beside.feed(SampleBatch.join(batches))
    one = alone.models.models(alone.slots, alone.inputs())
    all_of_them = beside.models.models(beside.slots, beside.inputs())
    for slot in (1, 4):
        other = take_rows(all_of_them, np.array([slot]))
        for name in one.__slots__:
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


@pytest.mark.parametrize("membership", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_true_residuals_lie_in_the_bounds_at_every_moment(seed: int, membership: bool) -> None:
    """Between fits, too, after the window has moved on, with few of the data chosen."""
    stream, batch = Stream(size=150, membership=membership, nearest=24), samples_of(history(seed), 0, 400)
    rng = np.random.default_rng(seed)
    limit = np.array([SPEED_COVERED, *[SVEA.steering_limit, SVEA.velocity_limit] * 3])
    for k in range(400):
        stream.feed(batch.take(np.array([k])))
        if k < 40 or k % 9:
            continue
        model = stream.models.models(stream.slots, stream.inputs())
        assert 1 <= model.held[0] <= 24
        half = limit * rng.uniform(0, 0.3, 7) * rng.choice([0.0, 0.2, 1.0])
        center = rng.uniform(-1, 1, 7) * (limit - half)
        xi = center + half * np.clip(rng.normal(size=(200, 7)), -1, 1)
        error = dynamics(xi) - apply(model.matrix, xi[None])[0]
        found = residual_set(model, center[None], half[None], membership=membership, plane=(0, 1))
        assert not found.contradicted.any()
        d = np.concatenate([np.eye(4), -np.eye(4), rng.normal(size=(40, 4))])
        height = d @ found.center[0] + np.abs(d @ found.generators[0]).sum(axis=1)
        assert (error @ d.T <= height + 1e-12).all()


def test_chosen_data_bounds_nearly_as_well_as_all_of_it() -> None:
    sizes: list[NDArray[np.float64]] = []
    for nearest in (1000, 64):
        stream = Stream(size=400, nearest=nearest)
        stream.feed(samples_of(history(2), 0, 420))
        model = stream.models.models(stream.slots, stream.inputs())
        at = np.concatenate([stream.models.newest(stream.slots)[:, 3:], np.zeros((1, 6))], axis=1)
        found = residual_set(model, at, np.full((1, 7), 0.02), membership=True)
        sizes.append(np.abs(found.generators[0]).sum(axis=1))
    assert (sizes[1] >= sizes[0] - 1e-12).all()
    assert (sizes[1] <= 1.1 * sizes[0]).all()


def test_older_data_that_differs_stays_and_bounds() -> None:
    """A fast stretch long ago still says something about fast driving: sets there are smaller, and hold the truth."""
    widths = []
    for rows in (0, 40):
        stream, rng = Stream(size=100, reservoir=rows, nearest=1000), np.random.default_rng(0)
        for k in range(0, 420, 5):
            stream.feed(samples_of(history(1), k, k + 5))
        quiet = samples_of(history(1), 0, 130)
        quiet.x[:] = [0.0, 0.0, 0.0, 0.3] + rng.uniform(-1, 1, (130, 4)) * 1e-3
        quiet.u[:] = [0.0, 0.3] + rng.uniform(-1, 1, (130, 2)) * 1e-2
        quiet.seq[:] += 500
        quiet.t[:] += 500 * SVEA.dt_ns
        quiet.x[:, 0] += 0.3 * SVEA.dt * np.arange(130)
        for k in range(130):
            stream.feed(quiet.take(np.array([k])))
        moments = stream.models._stream
        assert moments.valid[0, 100:].sum() == rows
        model = stream.models.models(stream.slots, stream.inputs())
        at = np.array([[1.5, *[0.3, 1.5] * 3]])
        found = residual_set(model, at, np.zeros((1, 7)), membership=True)
        error = dynamics(at) - apply(model.matrix, at[None])[0]
        assert (np.abs(error - found.center) <= np.abs(found.generators).sum(axis=2) + 1e-12).all()
        widths.append(np.abs(found.generators[0]).sum(axis=1))
    assert (widths[1] < 0.8 * widths[0]).all()


@pytest.mark.parametrize("membership", [True, False])
def test_a_system_without_inputs_is_served_too(membership: bool) -> None:
    """x+ = 0.9 x + w, one state, nothing else."""
    profile = parse_profile(
        {
            "class": "decay", "state": {"x": "m"}, "sample_time": SVEA.dt, "window": 40, "future_inputs": "plan",
            "noise": {
                "process": {"box": [0.01], "origin": "given"}, "measurement": {"box": [0.02], "origin": "given"},
            },
            "lipschitz": {"lower": [[0.85]], "upper": [[0.95]], "origin": "given"},
        }
    )  # fmt: skip
    layout, rng, count = RegressorSpec.of(profile), np.random.default_rng(0), 60
    bounds = NoiseBounds.of(profile, layout)
    window = Window(profile)
    window.grow(1)
    models = ResidualModels(profile, layout, bounds, profile.lipschitz, window, membership=membership)
    models.grow(1)
    x = np.zeros((count, 1))
    x[0] = 5.0
    for k in range(1, count):
        x[k] = 0.9 * x[k - 1] + rng.uniform(-0.01, 0.01)
    seq = np.arange(count)
    measured = x + rng.uniform(-0.02, 0.02, x.shape)
    batch = SampleBatch(
        np.zeros(count, dtype=np.intp), np.ones(count, dtype=np.uint64), seq.astype(np.uint64),
        START + seq * SVEA.dt_ns, np.zeros(count, dtype=np.uint32), measured, np.zeros((count, 0)),
    )  # fmt: skip
    window.append(batch)
    models.learn(np.array([0]))
    nothing = InputSets(np.zeros((1, 0, 0)), np.zeros((1, 5, 0)), np.zeros((1, 5, 0)))
    motion = Recursion(nothing, models.models(np.array([0]), nothing), bounds.process, layout, membership)
    one = np.array([0])
    sets = motion.begin(RawSets.zonotope(models.newest(one), bounds.measurement[None]), one)
    low = high = x[-1, 0]
    for k in range(5):
        sets, wrong = motion.advance(sets, k, one)
        assert not wrong.any()
        low, high = 0.9 * low - 0.01, 0.9 * high + 0.01
        half = np.abs(sets.generators[0]).sum()
        assert sets.center[0, 0] - half <= low
        assert high <= sets.center[0, 0] + half
        assert half < 1.0
