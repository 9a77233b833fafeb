"""The paper's Algorithm 1 as printed loses states that the corrected one holds."""

import numpy as np
import pytest

from fleet_bus.messages import Lipschitz
from fleet_lab.paper.algorithm_1 import Printed
from reach_server.data.regressors import RegressorSpec, Transitions
from reach_server.models.residual_model import NoiseBounds, fit, residual_set
from reach_server.numeric.types import FloatArray

NO_INPUT = np.zeros(0), np.zeros((0, 0))
ONE = np.zeros((1, 0))


def kinked(z: FloatArray) -> FloatArray:
    """Slope 1 up to 1, slope -2 beyond."""
    return np.asarray(np.where(z <= 1, z, 3 - 2 * z))


def of(z: FloatArray, after: FloatArray, lipschitz: float, radius: float, noise: FloatArray = ONE) -> Printed:
    return Printed(z, np.zeros((len(z), 0)), after, np.zeros(z.shape[1]), noise, lipschitz, radius)


def interval(found: tuple[FloatArray, FloatArray]) -> tuple[float, float]:
    center, generators = found
    half = float(np.abs(generators).sum())
    return float(center[0]) - half, float(center[0]) + half


def test_the_counterexample_is_missed_as_printed_and_covered_as_corrected() -> None:
    data = np.array([[-1.0], [1.0]])
    assert (np.abs(np.diff(kinked(np.linspace(-2, 2, 401)))) <= 2 * 0.01 + 1e-12).all()
    # Every point of [-2, 2] is at most δ = 1 from the data.
    printed = of(data, kinked(data), lipschitz=2.0, radius=1.0)
    assert interval(printed.step((np.array([2.0]), ONE), NO_INPUT)) == pytest.approx((0.0, 4.0))
    assert kinked(np.array(2.0)) == -1.0
    layout = RegressorSpec(1, 0, 0, None, (0,), ())
    transitions = Transitions(data[None], kinked(data)[None], np.ones((1, 2), dtype=bool), data[:1])
    model = fit(transitions, layout, NoiseBounds(ONE, ONE), Lipschitz(lower=[[-2.0]], upper=[[1.0]]))
    slope, constant = model.matrix[0, 0, 1], model.matrix[0, 0, 0]
    for z in np.linspace(-2, 2, 41):
        for membership in (False, True):
            e = residual_set(model, np.array([[z]]), np.zeros((1, 1)), membership=membership)
            low, high = interval((e.center[0], e.generators[0]))
            predicted = constant + slope * z
            assert predicted + low - 1e-9 <= kinked(z) <= predicted + high + 1e-9


def test_a_set_that_is_not_recentred_is_somewhere_else() -> None:
    """Line 6 at a linearisation point that is not the origin, with the identity for f."""
    z = np.linspace(-1, 1, 11)[:, None]
    printed = of(z, z, lipschitz=1.0, radius=0.1)
    set_now = np.array([0.5]), np.array([[0.1]])
    low, high = interval(printed.step(set_now, NO_INPUT))
    assert low <= 0.4
    assert high >= 0.6
    low, _ = interval(printed.step(set_now, NO_INPUT, (np.array([1.0]), np.zeros(0))))
    assert low > 0.6


def test_without_measurement_noise_and_with_the_same_allowance_it_is_the_residual_hull() -> None:
    """Lines 1 to 6 at the origin: hull of the residuals, noise of the data, noise of the step, L δ."""
    rng = np.random.default_rng(0)
    A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.1], [0.3]])
    x, u = rng.normal(size=(60, 2)), rng.normal(size=(60, 1))
    w = np.array([[0.02], [0.02]])
    after = x @ A.T + u @ B.T + rng.uniform(-1, 1, (60, 1)) @ w.T
    printed = Printed(x, u, after, np.zeros(2), w, 0.0, 0.0)
    set_now, known = (np.array([0.3, -0.2]), 0.1 * np.eye(2)), (np.array([0.4]), np.array([[0.05]]))
    center, generators = printed.step(set_now, known)
    layout = RegressorSpec(2, 1, 0, None, (0, 1), ())
    data = Transitions(np.column_stack([x, u])[None], after[None], np.ones((1, 60), dtype=bool), x[:1])
    model = fit(data, layout, NoiseBounds(w, np.zeros((2, 0))), None)
    hull = residual_set(model, np.zeros((1, 3)), np.zeros((1, 3)), membership=False)
    slopes = model.matrix[0, :, 1:]
    spread = np.concatenate([slopes[:, :2] @ set_now[1], slopes[:, 2:] @ known[1], hull.generators[0], w], axis=1)
    middle = model.matrix[0, :, 0] + slopes @ np.array([0.3, -0.2, 0.4]) + hull.center[0]
    d = rng.normal(size=(40, 2))
    heights = [d @ c + np.abs(d @ g).sum(axis=1) for c, g in ((center, generators), (middle, spread))]
    np.testing.assert_allclose(heights[0], heights[1], rtol=1e-9, atol=1e-12)


def test_a_tube_of_a_linear_system_without_noise_holds_and_is_reduced() -> None:
    rng = np.random.default_rng(1)
    A = np.array([[0.9, 0.2], [-0.1, 0.8]])
    x = rng.normal(size=(40, 2))
    printed = Printed(x, np.zeros((40, 0)), x @ A.T, np.zeros(2), np.zeros((2, 0)), 0.0, 0.0)
    tube = printed.tube((np.ones(2), 0.1 * rng.normal(size=(2, 9))), [NO_INPUT] * 5, kept=4)
    assert len(tube) == 5
    state = np.ones(2)
    for center, generators in tube:
        state = A @ state
        np.testing.assert_allclose(center, state, atol=1e-9)
        assert generators.shape[1] <= 6
