"""Sets within bounds: nothing of the intersection is lost, nothing is larger than the bounds, what fits stays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reach_server.audit.prediction_check import inside
from reach_server.numeric.types import FloatArray
from reach_server.sets.raw import RawSets
from reach_server.tube.reach_sets import ReachSets
from reach_server.tube.state_bounds import within
from reach_server.tube.summaries import OUTLINE_DIRECTIONS, PlaneStrips, summarize
from tests.reach_server.ugly import moderate

PLANE = (0, 1)


def reach_of(sets: RawSets) -> ReachSets:
    """One step, no side information."""
    count = len(sets.center)
    none = np.zeros(count, dtype=bool)
    found = summarize(sets, np.zeros((count, 0), dtype=bool), PlaneStrips.none(), PLANE)
    return ReachSets(
        (sets,), (sets,), found.area[:, None], found.area[:, None].copy(), found.heights[:, None], found.hull[:, None],
        np.zeros((count, 1, 0), dtype=bool), ~none, none, none, {},
    )  # fmt: skip


def some(rng: np.random.Generator, rows: int = 0) -> RawSets:
    """Sets (40, 4), with constraints or without."""
    scale = 10.0 ** rng.integers(-6, 12, (40, 1, 1))
    generators = rng.normal(size=(40, 4, 7)) * scale * (rng.random((40, 4, 7)) < 0.7)
    center = rng.normal(size=(40, 4))
    matrix = rng.normal(size=(40, rows, 7))
    return RawSets(center, generators, matrix, (matrix @ rng.uniform(-0.5, 0.5, (40, 7, 1)))[..., 0])


def points_of(rng: np.random.Generator, sets: RawSets) -> FloatArray:
    """Points (40, 200, 4) of sets without constraints, many near the center."""
    factors = rng.uniform(-1, 1, (40, 200, 7)) * 10.0 ** rng.uniform(-14, 0, (40, 200, 1))
    return np.asarray(sets.center[:, None] + np.einsum("bng,bkg->bkn", sets.generators, factors))


@moderate
@given(st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_what_both_hold_is_kept_and_nothing_reaches_beyond(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sets = some(rng)
    middle, half = sets.center + rng.normal(size=(40, 4)) * 0.3, rng.uniform(0.3, 2.0, (40, 4))
    half[rng.random((40, 4)) < 0.3] = np.inf
    low, high = middle - half, middle + half
    found, cut = within(reach_of(sets), low[:, None], high[:, None], PLANE, ())
    for held, areas in ((found.steps[0], found.area), (found.free[0], found.area_free)):
        points = points_of(rng, sets)
        both = ((points >= low[:, None]) & (points <= high[:, None])).all(axis=2)
        assert both.any()
        for b, k in np.argwhere(both)[::7]:
            one = RawSets(*(np.asarray(getattr(held, name)[[b]]) for name in RawSets.__slots__))
            assert inside(one, np.zeros((4, 0)), points[b, [k]], ())[0].all()
        spread = np.abs(held.generators).sum(axis=2)
        slack = 1e-5 * np.where(np.isfinite(half), half, 0.0) + 1e-12 * np.abs(held.center)
        excluded = (sets.center + np.abs(sets.generators).sum(axis=2) < low) | (
            sets.center - np.abs(sets.generators).sum(axis=2) > high
        )
        retained = ~excluded.any(axis=1)
        assert (held.center - spread >= low - slack)[retained].all()
        assert (held.center + spread <= high + slack)[retained].all()
        allowed = 4 * half[:, 0] * half[:, 1]
        assert (areas[:, 0] <= allowed * (1 + 1e-5))[retained].all()
    before = reach_of(sets)
    for row in np.flatnonzero(~cut):
        np.testing.assert_array_equal(found.steps[0].center[row], sets.center[row])
        np.testing.assert_array_equal(found.steps[0].generators[row, :, :7], sets.generators[row])
        assert not found.steps[0].generators[row, :, 7:].any()
        np.testing.assert_array_equal(found.heights[row], before.heights[row])


def test_outline_and_hull_hold_the_intersection() -> None:
    rng = np.random.default_rng(1)
    sets = some(rng)
    low, high = sets.center - 0.4, sets.center + 0.6
    found, _ = within(reach_of(sets), low[:, None], high[:, None], PLANE, ())
    points = points_of(rng, sets)
    both = np.asarray(((points >= low[:, None]) & (points <= high[:, None])).all(axis=2))
    moved = points - found.steps[0].center[:, None]
    for b in range(40):
        chosen = moved[b][np.asarray(both[b])]
        size = 1e-9 * (1 + np.abs(sets.center[b]).max())
        assert (chosen[:, PLANE] @ OUTLINE_DIRECTIONS.T <= found.heights[b, 0] + size).all()
        assert (chosen >= found.hull[b, 0, 0] - size).all()
        assert (chosen <= found.hull[b, 0, 1] + size).all()


def test_constrained_sets_stay_constrained_and_are_held() -> None:
    sets = some(np.random.default_rng(2), rows=2)
    low, high = sets.center - 1.0, sets.center + 1.0
    found, _ = within(reach_of(sets), low[:, None], high[:, None], PLANE, ())
    held = found.steps[0]
    assert held.matrix.shape[1] == 2
    assert (np.abs(held.generators).sum(axis=2) <= 1.0 + 1e-5).all()


def test_bounds_of_angles_hold_in_any_turn() -> None:
    center, generators = np.array([[0.0, 0.0, 0.1 + 4 * np.pi, 0.0]]), np.diag([1.0, 1.0, 5.0, 1.0])[None]
    low, high = np.array([[[-9.0, -9.0, -0.2, -9.0]]]), np.array([[[9.0, 9.0, 0.4, 9.0]]])
    found, cut = within(reach_of(RawSets.zonotope(center, generators)), low, high, PLANE, (2,))
    assert cut.all()
    spread = np.abs(found.steps[0].generators).sum(axis=2)[0, 2]
    np.testing.assert_allclose(found.steps[0].center[0, 2] - 4 * np.pi, 0.1, atol=1e-9)
    np.testing.assert_allclose(spread, 0.3, atol=1e-9)
