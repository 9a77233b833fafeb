"""Brackets hold the exact volume."""

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest

from reach_server.numeric.types import FloatArray
from reach_server.sets import SetError, Zonotope, volume
from tests.reach_server.ugly import ZONOTOPES, Raw, named


def exact_volume(generators: FloatArray) -> Fraction:
    """``2ⁿ Σ |det|`` in fractions."""
    n, g = generators.shape
    columns = [[Fraction(float(x)) for x in generators[:, j]] for j in range(g)]
    parts = (abs(_det([columns[j] for j in chosen])) for chosen in combinations(range(g), n))
    return Fraction(2**n) * sum(parts, Fraction(0))


def _det(rows: list[list[Fraction]]) -> Fraction:
    if not rows:
        return Fraction(1)
    minors = (_det([row[:k] + row[k + 1 :] for row in rows[1:]]) for k in range(len(rows)))
    return sum(((-1) ** k * rows[0][k] * minor for k, minor in enumerate(minors)), Fraction(0))


@pytest.mark.parametrize("case", ZONOTOPES, ids=named)
def test_the_bracket_holds_the_exact_volume(case: Raw) -> None:
    exact = exact_volume(case.G)
    inner, outer = case.zonotope().volume_bracket()
    assert 0 <= Fraction(float(inner)) <= exact <= Fraction(float(outer))
    hull = float((2 * np.abs(case.G).sum(axis=1)).prod())
    assert outer - inner <= 1e-11 * hull
    if case.n == 2:
        assert case.zonotope().area_bracket() == (inner, outer)
        assert float(case.zonotope().area()) == pytest.approx(float(exact), rel=1e-7, abs=1e-11 * hull)


@pytest.mark.parametrize(("n", "g"), [(3, 12), (4, 10), (5, 9)])
def test_the_cheap_bracket_holds_the_exact_volume(n: int, g: int, monkeypatch: pytest.MonkeyPatch) -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        generators = rng.normal(size=(n, g)) * rng.choice([1.0, 1e-2, 10.0], g) * rng.choice([1.0, 1e5], (n, 1))
        z = Zonotope(np.zeros(n), generators)
        exact = float(z.volume())
        with monkeypatch.context() as patch:
            patch.setattr(volume, "EXACT", 20)
            inner, outer = z.volume_bracket()
        assert inner <= exact * (1 + 1e-9)
        assert outer >= exact * (1 - 1e-9)
        assert outer <= 60 * inner


def test_many_generators_are_bracketed_at_once() -> None:
    rng = np.random.default_rng(0)
    z = Zonotope(np.zeros((4, 6)), rng.normal(size=(4, 6, 40)))
    inner, outer = z.volume_bracket()
    assert (inner > 0).all()
    assert (inner < outer).all()
    assert np.isfinite(outer).all()
    one = Zonotope(np.zeros(6), z.generators[2]).volume_bracket()
    np.testing.assert_allclose([inner[2], outer[2]], one, rtol=1e-9)


def test_flat_and_empty_batches() -> None:
    flat = Zonotope(np.zeros(3), np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 0.0]]))
    np.testing.assert_array_equal(flat.volume_bracket(), [0.0, 0.0])
    few = Zonotope(np.zeros(3), np.ones((3, 1)))
    inner, outer = few.volume_bracket()
    assert inner == 0.0 <= outer <= 1e-10
    assert Zonotope(np.zeros((0, 3)), np.zeros((0, 3, 4))).volume_bracket()[0].shape == (0,)
    assert Zonotope(np.zeros((5, 2)), np.eye(2)).area().shape == (5,)


def test_areas_are_of_planar_sets() -> None:
    z = Zonotope(np.zeros(3), np.eye(3))
    with pytest.raises(SetError, match="area needs a planar set, this one has dimension 3"):
        z.area()
    with pytest.raises(SetError, match="area_bracket needs a planar set"):
        z.area_bracket()
