"""Sizes of errors: nonnegative least squares, quantiles, and scores by sizes that have not seen them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls

from reach_server.models.conformal import scale as sizing
from reach_server.numeric.types import FloatArray
from tests.reach_server.ugly import moderate


@moderate
@given(st.integers(0, 2**32 - 1))
def test_nonnegative_least_squares_is_that_of_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    psi = np.abs(rng.normal(size=(80, 6))) * rng.uniform(0.1, 10.0, 6)
    psi[:, 0] = 1.0
    y = np.abs(psi @ np.maximum(rng.normal(size=6), 0.0) + 0.3 * rng.normal(size=80))
    least = 0.2 * y.mean()
    lower = np.r_[least, np.zeros(5)]
    solution = np.empty(6)
    sizing.nonnegative(psi.T @ psi, psi.T @ y, lower, solution)
    wanted, _ = nnls(psi, y - least)
    wanted[0] += least
    assert (solution >= lower).all()
    reached, best = (np.square(psi @ s - y).sum() for s in (solution, wanted))
    assert reached <= best * (1 + 1e-4) + 1e-9


@moderate
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0), st.integers(1, 50))
def test_quantiles_are_order_statistics(seed: int, part: float, rows: int) -> None:
    values = np.random.default_rng(seed).integers(0, 9, size=(rows, 2)).astype(np.float64)
    rank = min(max(int(np.ceil(part * rows - 1e-9)), 1), rows)
    assert sizing._quantile(values, 1, part) == np.sort(values[:, 1])[rank - 1]


def slow_shape(psi: FloatArray, magnitude: FloatArray, missing: FloatArray) -> FloatArray:
    """Coefficients (Q, n) as the formulas say."""
    columns = []
    for i in range(magnitude.shape[1]):
        mean = magnitude[:, i].mean()
        solution, _ = nnls(psi, magnitude[:, i] - sizing.CONSTANT_PART * mean)
        solution[0] += sizing.CONSTANT_PART * mean
        ratio = magnitude[:, i] / np.sqrt(mean * (psi @ solution))
        rank = int(np.ceil(len(ratio) * (1 - missing[i]) - 1e-9))
        columns.append(np.sort(ratio)[rank - 1] ** 2 * mean * solution)
    return np.stack(columns, axis=1)


def test_sizes_and_scores_are_what_the_formulas_say() -> None:
    rng = np.random.default_rng(4)
    rows, confidence = 300, 0.95
    psi = np.abs(rng.normal(size=(rows, 4)))
    psi[:, 0] = 1.0
    magnitude = np.abs(rng.normal(size=(rows, 3))) * (psi @ [0.3, 0.0, 1.0, 0.1])[:, None] * [1.0, 2.0, 0.01]
    plane = np.array([True, True, False])
    missing = np.where(plane, 1 - confidence, (1 - confidence) * sizing.OTHERS_MISS)
    shape, score = np.empty((4, 3)), np.empty((rows, 2))
    sizing._fit_step(psi, magnitude, plane, 0b011, confidence, shape, score)
    np.testing.assert_allclose(shape, slow_shape(psi, magnitude, missing), rtol=2e-3, atol=1e-6)
    for fold in range(sizing.FOLDS):
        tested = np.arange(fold * rows // sizing.FOLDS, (fold + 1) * rows // sizing.FOLDS)
        rest = np.setdiff1d(np.arange(rows), tested)
        size = np.sqrt(psi[tested] @ slow_shape(psi[rest], magnitude[rest], missing))
        for g, states in enumerate((plane, ~plane)):
            wanted = (magnitude[tested] / size)[:, states].max(axis=1)
            np.testing.assert_allclose(score[tested, g], wanted, rtol=2e-3)
    # Positions leave their sizes as often as the confidence says, the other state a quarter as often.
    outside = (magnitude > np.sqrt(psi @ shape)).sum(axis=0)
    np.testing.assert_allclose(outside, np.floor(rows * missing), atol=1.01)


def test_errors_of_zero_have_sizes() -> None:
    psi = np.ones((50, 2))
    shape, score = np.empty((2, 2)), np.empty((50, 2))
    sizing._fit_step(psi, np.zeros((50, 2)), np.array([True, False]), 0b01, 0.9, shape, score)
    assert (shape[0] > 0).all()
    assert np.isfinite(score).all()


def test_regressors_are_cut_off() -> None:
    psi = np.random.default_rng(0).exponential(size=(200, 3))
    before, clip = psi.copy(), np.empty(3)
    sizing._clip(psi, clip)
    np.testing.assert_array_equal(clip, np.sort(before, axis=0)[197])
    np.testing.assert_array_equal(psi, np.minimum(before, clip))


def test_what_came_later_is_not_measured_in_sizes_of_nothing() -> None:
    """A speed that a sensor says exactly, while the vehicle stands, has no error at all in the first folds."""
    rng = np.random.default_rng(2)
    psi, magnitude = np.ones((900, 1)), np.abs(rng.normal(size=(900, 2)))
    magnitude[:860, 1] = 0.0
    shape, score = np.empty((1, 2)), np.empty((900, 2))
    sizing._fit_step(psi, magnitude, np.array([True, False]), 0b01, 0.99, shape, score)
    assert (
        score[:, 1].max()
        <= magnitude[:, 1].max() / (sizing.LEAST_BALANCE * sizing.FOLD_PART * magnitude[:, 1].mean()) * 3
    )
    assert score[:, 0].max() < 5
