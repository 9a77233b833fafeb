"""Order reduction encloses, whatever the method and the batch."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reach_server.numeric.types import FloatArray
from reach_server.sets import Direction, SetError, Zonotope
from reach_server.sets.order_reduction import ReductionMethod, boxed, girard, parallelotope, reduce_generators
from reach_server.sets.polygon import zonotope_area
from tests.reach_server.ugly import ZONOTOPES, Raw, assert_holds, corners, directions, moderate, named, of, random_sets

METHODS: tuple[ReductionMethod, ...] = ("girard", "combastel", "pca", "scott")
methods = pytest.mark.parametrize("method", METHODS)
every = pytest.mark.parametrize("case", ZONOTOPES, ids=named)


def reach(generators: FloatArray, d: FloatArray) -> FloatArray:
    return np.asarray(np.abs(d @ generators).sum(axis=-1))


def many(seed: int, n: int, g: int, flat: int | None = None) -> FloatArray:
    """Generators of a flat of that dimension, coordinates of unlike size."""
    rng = np.random.default_rng(seed)
    inside = rng.normal(size=(flat or n, g)) * rng.choice([1.0, 1e-3, 1e3], size=g)
    return np.asarray(np.linalg.qr(rng.normal(size=(n, n)))[0][:, : flat or n] @ inside)


def assert_encloses(reduced: FloatArray, generators: FloatArray) -> None:
    """In every direction as far as before: along axes, at random, and across and along either set's generators."""
    n = len(generators)
    d = np.concatenate([directions(n, 60), generators.T, reduced.T])
    if n == 2:
        d = np.concatenate([d, d @ np.array([[0.0, 1.0], [-1.0, 0.0]])])
    # Comparing rounds, too: relative to the terms of the sums.
    rounding = 1e-15 * generators.shape[1] * (np.abs(d) @ np.abs(generators).sum(axis=1))
    assert (reach(reduced, d) >= reach(generators, d) - rounding).all()


@every
@methods
@pytest.mark.parametrize("count", [0, 1, 2, 3, 4, 8])
def test_reduced_sets_reach_as_far_in_every_direction(case: Raw, method: ReductionMethod, count: int) -> None:
    reduced = reduce_generators(case.G, count, method)
    assert reduced.shape[-1] <= max(count, case.n)
    assert_encloses(reduced, case.G)


@methods
@pytest.mark.parametrize(("n", "flat"), [(1, 1), (2, 2), (2, 1), (3, 3), (3, 2), (3, 1), (6, 6), (6, 4)])
def test_large_and_flat_sets_are_enclosed(method: ReductionMethod, n: int, flat: int) -> None:
    for seed in range(5):
        generators = many(seed, n, 20, flat)
        for count in (n, n + 3, 19):
            reduced = reduce_generators(generators, count, method)
            assert reduced.shape == (n, count)
            assert_encloses(reduced, generators)
            rng = np.random.default_rng(seed)
            samples = Zonotope(np.zeros(n), generators).sample(rng, 4, "factors")
            assert_holds(of(Zonotope(np.zeros(n), reduced)), samples, of(Zonotope(np.zeros(n), generators)))


@methods
@moderate
@given(case=random_sets(rows=0), order=st.sampled_from([1, 1.5, 2]))
def test_random_sets_reduce_to_enclosures(method: ReductionMethod, case: Raw, order: float) -> None:
    z = case.zonotope()
    reduced = z.reduce_order(order, method)
    assert reduced.generators.shape[-1] <= max(int(order * case.n), case.n)
    assert_encloses(reduced.generators, case.G)
    assert_holds(of(reduced), corners(case)[:4], case)
    changed = reduced.generators.shape[-1] < case.G.shape[-1]
    assert reduced.direction is (Direction.OUTER if changed else Direction.EXACT)


def test_methods_that_turn_do_better_on_turned_sets() -> None:
    area: dict[ReductionMethod, list[float]] = {method: [] for method in METHODS}
    for seed in range(50):
        rng = np.random.default_rng(seed)
        angle = rng.uniform(0, np.pi)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        generators = turn @ (rng.normal(size=(2, 12)) * [[5.0], [0.3]])
        for method in METHODS:
            reduced = reduce_generators(generators, 2, method)
            area[method].append(float(zonotope_area(reduced) / zonotope_area(generators)))
    median = {method: np.median(values) for method, values in area.items()}
    assert median["pca"] < 0.5 * median["girard"]
    assert median["scott"] < 0.5 * median["girard"]
    assert all(min(values) >= 1 - 1e-9 for values in area.values())


@methods
def test_each_set_of_a_batch_is_reduced_by_its_own_ranking(method: ReductionMethod) -> None:
    batch = np.random.default_rng(0).normal(size=(3, 2, 4, 9))
    batch[0, 0, :, 2:] = 0.0  # flat beside full ones
    batch[1, 1] = batch[1, 1] * [[0.0], [1.0], [0.0], [1.0]]
    wide = reduce_generators(batch, 6, method)
    assert wide.shape == (3, 2, 4, 6)
    for place in np.ndindex(3, 2):
        np.testing.assert_allclose(wide[place], reduce_generators(batch[place], 6, method), rtol=1e-9, atol=1e-12)
    assert reduce_generators(batch[:0], 6, method).shape == (0, 2, 4, 6)


@every
@pytest.mark.parametrize("count", [0, 2, 4, 8])
def test_boxed_sets_end_with_a_box(case: Raw, count: int) -> None:
    reduced = boxed(case.G, count)
    assert_encloses(reduced, case.G)
    last = reduced[:, -case.n :]
    np.testing.assert_array_equal(last, np.diag(np.diag(last)))
    assert (np.diag(last) >= 0).all()
    assert reduced.shape[-1] <= max(count, case.n)


@methods
def test_few_generators_come_back_unchanged(method: ReductionMethod) -> None:
    generators = np.random.default_rng(0).normal(size=(2, 5))
    assert reduce_generators(generators, 5, method) is generators
    assert reduce_generators(generators, 9, method) is generators
    assert girard(generators, 9) is generators


def test_a_parallelotope_along_crooked_axes_still_encloses() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        axes = rng.normal(size=(3, 3))
        axes[:, 2] = axes[:, 0] + 1e-6 * axes[:, 2]
        generators = rng.normal(size=(3, 5))
        assert_encloses(parallelotope(axes, generators), generators)


@pytest.mark.parametrize(
    ("order", "method", "message"),
    [
        (0, "girard", "order is 0, expected a positive number"),
        (-1.0, "pca", "order is -1.0"),
        (np.nan, "girard", "order is nan"),
        ("two", "girard", "order is 'two'"),
        (1, "best", "method is 'best', expected one of girard, combastel, pca, scott"),
    ],
)
def test_bad_orders_and_methods_are_refused(order: float, method: ReductionMethod, message: str) -> None:
    with pytest.raises(SetError, match=message):
        Zonotope(np.zeros(2), np.ones((2, 5))).reduce_order(order, method)


def test_an_infinite_order_changes_nothing() -> None:
    z = Zonotope(np.zeros(2), np.ones((2, 5)))
    assert z.reduce_order(np.inf).generators.shape == (2, 5)
