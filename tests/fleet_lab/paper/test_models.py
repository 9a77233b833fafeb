"""The sets before any cut against a direct transcription of Algorithm 1, and against sampled systems."""

from itertools import product

import numpy as np
import pytest

from fleet_lab.paper import models
from fleet_lab.paper.cuts import holds
from fleet_lab.paper.drives import Data
from fleet_lab.paper.study import Study, measured
from reach_server.numeric.types import FloatArray

NOTHING = np.zeros((2, 0))


@pytest.fixture(scope="module")
def data(study: Study) -> Data:
    return Data.of(study.before)


@pytest.fixture(scope="module")
def states(study: Study) -> tuple[FloatArray, FloatArray]:
    """Some positions and inputs (S, 2), and others that no drive had."""
    rng, track = np.random.default_rng(0), study.lot[1]
    x = np.concatenate([track.position[::400], rng.uniform(-5, 5, (5, 2))])
    return x, np.concatenate([track.velocity[::400], rng.uniform(-2, 2, (5, 2))])


def lines_1_to_3(data: Data, x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """M at the linearisation point (x*, u*), and the residuals' bounds."""
    X, U, after = data.x.T, data.u.T, data.after.T
    rows = np.vstack([np.ones((1, X.shape[1])), X - x[:, None], U - u[:, None]])
    M = after @ np.linalg.pinv(rows)
    upper, lower = np.full(2, -np.inf), np.full(2, np.inf)
    for j in range(X.shape[1]):
        residual = after[:, j] - M @ rows[:, j]
        upper, lower = np.maximum(upper, residual), np.minimum(lower, residual)
    return M, lower, upper


@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0, 0.0), (3.0, -7.0, 1.0, 0.4), (-0.3, 0.9, -2.0, 5.0)])
def test_the_published_codes_set_at_any_linearisation_point(
    data: Data, states: tuple[FloatArray, FloatArray], point: tuple[float, ...]
) -> None:
    at, by = np.array(point[:2]), np.array(point[2:])
    M, low, high = lines_1_to_3(data, at, by)
    found = models.as_published_code(data, *states)
    half = (high - low) / 2
    areas = found.area()
    for k, (x, u) in enumerate(zip(*states, strict=True)):
        center = M @ np.concatenate([[1.0], x - at, u - by]) + (high + low) / 2
        np.testing.assert_allclose(found.center[k], center, atol=1e-8)
        # box(residuals) and the box around -Z_w, then Z_w itself.
        box = half + 0.9
        np.testing.assert_allclose(found.generators[k], [[box[0], 0, 0.9], [0, box[1], 0.9]], atol=1e-8)
        assert areas[k] == pytest.approx(4 * box[0] * box[1] + 4 * 0.9 * box.sum(), rel=1e-9)
    assert (half < 0.0003).all()
    # The noise alone has 12 * 0.81 m².
    assert areas[0] == pytest.approx(12 * 0.81 + 4 * 1.8 * half.sum(), abs=1e-6)


def test_the_printed_set_is_algorithm_1_as_the_core_has_it(data: Data, states: tuple[FloatArray, FloatArray]) -> None:
    found, algorithm = models.as_printed(data, *states), models.printed(data)
    for k, (x, u) in enumerate(zip(*states, strict=True)):
        center, generators = algorithm.step((x, NOTHING), (u, NOTHING))
        np.testing.assert_allclose(found.center[k], center, atol=1e-8)
        for angle in np.linspace(0, np.pi, 9):
            direction = np.array([np.cos(angle), np.sin(angle)])
            assert np.abs(direction @ found.generators[k]).sum() == pytest.approx(np.abs(direction @ generators).sum())
    # Both Z_w stay a segment: together with a thin box, nothing like 9.72 m².
    _, low, high = lines_1_to_3(data, np.zeros(2), np.zeros(2))
    box = (high - low) / 2 + algorithm.lipschitz * algorithm.radius
    # The two boxes are one.
    assert found.area()[0] == pytest.approx(4 * box[0] * box[1] + 4 * 1.8 * box.sum(), rel=1e-6)
    assert found.area()[0] < 1.0


def test_lipschitz_constant_and_covering_radius_are_those_of_the_data(data: Data) -> None:
    some = Data(data.x[::20], data.u[::20], data.after[::20])
    z = np.column_stack([some.x, some.u])
    slopes, nearest = [], []
    for j in range(len(z)):
        others = [i for i in range(len(z)) if i != j]
        slopes += [np.linalg.norm(some.after[i] - some.after[j]) / np.linalg.norm(z[i] - z[j]) for i in others]
        nearest.append(min(np.linalg.norm(z[i] - z[j]) for i in others))
    found = models.printed(some)
    assert found.lipschitz == pytest.approx(max(slopes))
    assert found.radius == pytest.approx(max(nearest))


SYSTEMS = {
    "a point that is pushed": (np.eye(2), 0.01 * np.eye(2), np.zeros(2)),
    "shearing": (np.array([[1.0, 0.3], [0.0, 0.9]]), np.array([[0.4, 0.0], [0.1, 0.2]]), np.array([0.2, -0.1])),
    "turning": (np.array([[0.5, -0.8], [0.3, 1.2]]), np.array([[0.0, 1.0], [-1.0, 0.5]]), np.array([-1.0, 2.0])),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_sets_from_noisy_data_hold_what_comes_next(name: str) -> None:
    """Of linear systems, for states among those of the data: 100 000 in all, noise at its worst among them.

    Data whose every error is the same shift the model by it, and the next error goes the other way: nothing more can
    happen, so a set that takes one Z_v less loses some of these.
    """
    rng, (A, B, c) = np.random.default_rng(1), SYSTEMS[name]
    known, asked, tightest = 40, 850, np.inf
    worst = list(product((-1.0, 1.0), repeat=3))
    for signs in (*worst, *[None] * 32):
        x, u = rng.uniform(-3, 3, (known, 2)), rng.uniform(-1, 1, (known, 2))
        w, v, after_v = rng.uniform(-1, 1, (3, known, 1)) if signs is None else np.array(signs)[:, None, None]
        after = x @ A.T + u @ B.T + c + w * models.PROCESS_NOISE.T
        data = Data(x + v * models.MEASUREMENT_NOISE.T, u, after + after_v * models.MEASUREMENT_NOISE.T)
        # In the hull of the data, where what the model leaves of a linear system is no larger than at them.
        weights = rng.dirichlet(np.full(known, 0.2), asked)
        x, u = weights @ x, weights @ u
        w, v = rng.uniform(-1, 1, (2, asked, 1))
        if signs is not None:
            w, v = np.sign(w), np.sign(v)
        after = x @ A.T + u @ B.T + c + w * models.PROCESS_NOISE.T
        sets = models.with_noise(data, x + v * models.MEASUREMENT_NOISE.T, u)
        assert holds(sets, after).all()
        ahead = np.abs((after - sets.center).sum(axis=1))
        tightest = min(tightest, float((np.abs(sets.generators.sum(axis=1)).sum(axis=1) - ahead).min()))
    assert tightest < (1e-9 if name == "a point that is pushed" else 0.1)


def test_noise_makes_the_sets_as_much_larger_as_it_is(study: Study, states: tuple[FloatArray, FloatArray]) -> None:
    rng = np.random.default_rng(2)
    seen = Data.of([measured(track, rng) for track in study.before])
    found, without = models.with_noise(seen, *states), models.as_published_code(seen, *states)
    np.testing.assert_array_equal(found.center, without.center)
    for direction in (np.eye(2)[0], np.eye(2)[1], np.array([0.6, 0.8])):
        grown = np.abs(direction @ found.generators).sum(axis=1) - np.abs(direction @ without.generators).sum(axis=1)
        assert (grown >= 3 * 0.01 * direction.sum() - 1e-12).all()
        assert (grown <= 3 * 0.01 * direction.sum() + 0.001).all()


def test_measured_positions_are_off_by_a_segment(study: Study) -> None:
    track = study.lot[0]
    error = measured(track, np.random.default_rng(3)).position - track.position
    np.testing.assert_allclose(error[:, 0], error[:, 1], atol=1e-15)
    assert 0.0099 < np.abs(error).max() <= 0.01
