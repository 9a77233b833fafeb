"""Samples lie in the set, on its boundary where asked, and are spread evenly."""

import numpy as np
import pytest

from reach_server.numeric.types import FloatArray
from reach_server.sets import SetError, Zonotope, tiling
from reach_server.sets.sampling import SampleMethod
from tests.reach_server.ugly import ROUNDING, ZONOTOPES, Raw, gap, named

every = pytest.mark.parametrize("case", ZONOTOPES, ids=named)
kinds = pytest.mark.parametrize("how", ["inside", "boundary", "factors"])


@every
@kinds
def test_samples_are_members(case: Raw, how: SampleMethod) -> None:
    samples = case.zonotope().sample(np.random.default_rng(0), 20, how)
    assert samples.shape == (20, case.n)
    assert max(gap(case, x) for x in samples) <= ROUNDING


@every
def test_points_of_the_boundary_have_members_beyond_reach(case: Raw) -> None:
    if not case.G.any():
        return
    z = case.zonotope()
    for x in z.sample(np.random.default_rng(1), 10, "boundary"):
        # A little farther from the center, within the flat of the set, is outside.
        assert not z.contains_point(case.c + (x - case.c) * (1 + 1e-3))
        assert z.contains_point(case.c + (x - case.c) * (1 - 1e-9))


def share_below(points: FloatArray, edges: FloatArray) -> FloatArray:
    return np.asarray((points[:, None] <= edges).mean(axis=0))


@pytest.mark.parametrize("n", [1, 2, 3])
def test_inner_points_are_uniform(n: int) -> None:
    rng = np.random.default_rng(n)
    z = Zonotope(np.zeros(n), rng.normal(size=(n, 5)))
    points = z.sample(rng, 8000)
    # By rejection from the box: uniform for certain.
    low, high = z.interval_hull()
    candidates = rng.uniform(low, high, (8000, n))
    if n == 1:
        uniform = candidates
    else:
        normals = _normals(z.generators)
        uniform = candidates[(np.abs(candidates @ normals.T) <= np.abs(normals @ z.generators).sum(axis=1)).all(axis=1)]
    for d in rng.normal(size=(6, n)):
        edges = np.quantile(uniform @ d, [0.05, 0.25, 0.5, 0.75, 0.95])
        np.testing.assert_allclose(share_below(points @ d, edges), [0.05, 0.25, 0.5, 0.75, 0.95], atol=0.04)


def _normals(generators: FloatArray) -> FloatArray:
    n, g = generators.shape
    if n == 2:
        return np.stack([-generators[1], generators[0]], axis=1)
    return np.array([np.cross(generators[:, i], generators[:, j]) for i in range(g) for j in range(i)])


def test_boundary_points_of_a_box_fall_on_its_faces_by_their_area() -> None:
    box = Zonotope.box([0.0, 0.0, 0.0], [1.0, 2.0, 4.0])
    points = box.sample(np.random.default_rng(0), 6000, "boundary")
    on = np.isclose(points, 0.0) | np.isclose(points, [1.0, 2.0, 4.0])
    np.testing.assert_allclose(on.mean(axis=0), np.array([8.0, 4.0, 2.0]) / 14, atol=0.03)
    np.testing.assert_allclose(points.mean(axis=0), [0.5, 1.0, 2.0], atol=0.06)


def test_flat_sets_are_filled_in_their_flat() -> None:
    rng = np.random.default_rng(0)
    flat = rng.normal(size=(4, 2)) @ rng.normal(size=(2, 6))
    factors = tiling.inner_factors(flat[None], rng, 500)[0]
    assert np.linalg.matrix_rank(factors @ flat.T, tol=1e-8) == 2
    # All but two factors are at their bounds: that is what a tile is.
    assert ((np.abs(factors) == 1).sum(axis=1) == 4).all()


def test_more_choices_than_are_looked_at_still_give_members(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiling, "CHOICES", 30)
    rng = np.random.default_rng(0)
    case = Raw("", np.zeros(3), rng.normal(size=(3, 12)), np.zeros((0, 12)), np.zeros(0))
    for how in ("inside", "boundary"):
        for x in case.zonotope().sample(rng, 20, how):
            assert gap(case, x) <= ROUNDING


@kinds
@pytest.mark.parametrize("shape", [(), (3,), (2, 3), (0,)], ids=str)
def test_batches_of_unlike_sets(how: SampleMethod, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    generators = rng.normal(size=(*shape, 3, 5))
    if shape == (2, 3):
        generators[0, 0] = 0.0
        generators[0, 1, 2] = 0.0
        generators[1, 1, :, 1:] = 0.0
    center = rng.normal(size=(*shape, 3))
    samples = Zonotope(center, generators).sample(rng, 7, how)
    assert samples.shape == (*shape, 7, 3)
    for place in np.ndindex(*shape):
        case = Raw("", center[place], generators[place], np.zeros((0, 5)), np.zeros(0))
        assert max(gap(case, x) for x in samples[place]) <= ROUNDING
    assert Zonotope(center, generators).sample(rng, 0, how).shape == (*shape, 0, 3)


def test_bad_requests_are_refused() -> None:
    z, rng = Zonotope(np.zeros(2), np.eye(2)), np.random.default_rng(0)
    with pytest.raises(SetError, match="count is -1"):
        z.sample(rng, -1)
    with pytest.raises(SetError, match=r"count is 1.5, expected a whole number"):
        z.sample(rng, 1.5)  # type: ignore[arg-type]
    with pytest.raises(SetError, match="how is 'everywhere', expected one of inside, boundary, factors"):
        z.sample(rng, 1, "everywhere")  # type: ignore[arg-type]
