"""Reduction of single sets in place: an enclosure, as few columns as asked for, and the one of the batch operation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reach_server.numeric.types import FloatArray
from reach_server.sets.kernels.order_reduction import reduce_one
from reach_server.sets.order_reduction import girard
from tests.reach_server.ugly import moderate


def reduced(generators: FloatArray, kept: int, rows: int | None = None) -> FloatArray:
    """The columns left of ``generators`` (z, g)."""
    z, g = generators.shape
    room = np.zeros((z, g + 3))
    room[:, :g] = generators
    work = np.empty((2, g + 3)), np.empty(z), np.empty(g + 3, dtype=np.int64)
    used = reduce_one(room, g, z if rows is None else rows, kept, *work)
    return room[:, :used].copy()


def assert_encloses(outer: FloatArray, inner: FloatArray) -> None:
    rng = np.random.default_rng(0)
    d = np.concatenate([np.eye(len(inner)), rng.normal(size=(60, len(inner)))])
    large, small = (np.abs(d @ g).sum(axis=1) for g in (outer, inner))
    assert (large >= small * (1 - 1e-13)).all()


@moderate
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(0, 30), st.integers(0, 20), st.sampled_from([0, 1, 2, 3])
)
def test_the_set_is_enclosed_by_few_columns(seed: int, z: int, g: int, kept: int, ugly: int) -> None:
    rng = np.random.default_rng(seed)
    generators = rng.normal(size=(z, g))
    if ugly == 1:
        generators = np.round(generators)  # equal scores, zero columns and rows
    if ugly == 2:
        generators *= 10.0 ** rng.integers(-12, 12, (z, g))
    if ugly == 3:
        generators[:, rng.random(g) < 0.5] = 0.0
        generators[rng.random(z) < 0.5] = 0.0
    found = reduced(generators, kept)
    assert found.shape[1] <= kept + z
    assert_encloses(found, generators)
    if g > kept + z and z > 1 and not ugly:
        batch = girard(generators, kept + z)
        rows = [sorted(map(tuple, np.round(c.T, 9).tolist())) for c in (found, batch)]
        assert rows[0] == rows[1]


def test_rows_beyond_those_that_live_stay_as_they_are() -> None:
    generators = np.zeros((5, 12))
    generators[:2] = np.random.default_rng(0).normal(size=(2, 12))
    found = reduced(generators, 3, rows=2)
    assert found.shape == (5, 5)
    assert not found[2:].any()
    assert_encloses(found[:2], generators[:2])


@pytest.mark.parametrize("wrong", [np.inf, np.nan])
def test_what_is_not_finite_stays_so(wrong: float) -> None:
    generators = np.random.default_rng(0).normal(size=(2, 12))
    generators[0, 3] = wrong
    assert not np.isfinite(reduced(generators, 2)).all()
