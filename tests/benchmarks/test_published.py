"""The published form that the engine is timed beside, held against other ways to write it."""

from functools import partial

import numpy as np
import pytest

from benchmarks import updates
from benchmarks.published import noise_matrix_zonotope, tube
from fleet_lab import fleets
from fleet_lab.paper.algorithm_1 import Printed

N, Q, SAMPLES, STEPS = 3, 2, 40, 3


class Data:
    """Random data of a system that is not affine, a start, a plan and noise whose center is not zero."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.x, self.u = rng.normal(size=(SAMPLES, N)), rng.normal(size=(SAMPLES, Q))
        self.after = self.x @ rng.normal(size=(N, N)) + np.sin(self.u @ rng.normal(size=(Q, N)))
        self.start = rng.normal(size=N), rng.normal(size=(N, 2))
        self.plan = rng.normal(size=(STEPS, Q))
        self.noise = rng.normal(size=N), rng.normal(size=(N, 2))
        self.tube = partial(tube, self.x.T, self.u.T, self.after.T, self.start, self.plan, self.noise)


@pytest.mark.parametrize("seed", range(3))
def test_steps_are_those_of_the_printed_algorithm(seed: int) -> None:
    """As it is printed on data that count from the point of linearisation."""
    data = Data(seed)
    before = data.start
    for found, known in zip(data.tube(np.full(N, 0.06), [], 1000), data.plan, strict=True):
        center, generators = before
        printed = Printed(data.x - center, data.u - known, data.after, *data.noise, lipschitz=0.3, radius=0.2)
        before = printed.step((np.zeros(N), generators), (np.zeros(Q), np.zeros((Q, 0))))
        # Columns of zeros, where there are any, are nothing.
        kept = [one[:, np.abs(one).max(axis=0) > 0] for one in (found[1], before[1])]
        np.testing.assert_allclose(found[0], before[0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(kept[0], kept[1], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_a_strip_is_cut_by_the_least_zonotope_of_its_kind(seed: int) -> None:
    """Algorithm 2: of ``c + λ (y - h·c)`` with ``[(I - λ hᵀ) G, λ r]``, λ of the least Frobenius norm, by least
    squares over its entries."""
    data = Data(seed)
    rng = np.random.default_rng(seed)
    strips = [(rng.normal(size=N), float(rng.normal()), float(rng.uniform(0.1, 1.0))) for _ in range(2)]
    center, generators = data.tube(np.zeros(N), [], 1000)[0]
    for h, y, r in strips:
        rows, wanted = np.append(h @ generators, -r), np.column_stack([generators, np.zeros(N)])
        weight = np.linalg.lstsq(rows[:, None], wanted.T, rcond=None)[0][0]
        center = center + weight * (y - h @ center)
        generators = np.column_stack([(np.eye(N) - np.outer(weight, h)) @ generators, weight * r])
    found = data.tube(np.zeros(N), strips, 1000)[0]
    np.testing.assert_allclose(found[0], center, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[1], generators, rtol=1e-9, atol=1e-9)


def test_the_matrix_zonotope_changes_no_set() -> None:
    data = Data(0)
    strips = [(np.eye(N)[0], 0.0, 0.5)]
    both = [data.tube(np.zeros(N), strips, 8, matrix_zonotope=built) for built in (True, False)]
    for one, other in zip(*both, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


def test_the_matrix_zonotope_holds_a_noise_at_each_sample() -> None:
    data = Data(0)
    center, generators = noise_matrix_zonotope(data.noise, 4)
    assert generators.shape == (2 * 4, N, 4)
    factors = np.random.default_rng(1).uniform(-1.0, 1.0, (2, 4))
    value = center + np.tensordot(factors.reshape(-1), generators, axes=1)
    np.testing.assert_allclose(value, data.noise[0][:, None] + data.noise[1] @ factors)


@pytest.mark.parametrize("seed", range(3))
def test_reduction_keeps_every_support(seed: int) -> None:
    data = Data(seed)
    whole, fewer = (data.tube(np.zeros(N), [], kept)[0] for kept in (1000, 6))
    assert fewer[1].shape[1] <= 6 < whole[1].shape[1]
    directions = np.random.default_rng(seed).normal(size=(50, N))
    support = [
        directions @ center + np.abs(directions @ generators).sum(axis=1) for center, generators in (whole, fewer)
    ]
    assert np.all(support[1] >= support[0] - 1e-9)


@pytest.mark.slow
def test_the_engine_knows_no_slopes_there_either() -> None:
    """Z_ε is zero on both sides: the bounds of the car hold in its own frame, `paper` fits in that of the world."""
    drives = fleets.cars(updates.samples(120, 2, 1), window=120, horizon=2)
    tubes = updates.measure(drives, 1, "paper", updates=1).newest
    assert drives.profile.frame == "body"
    assert set(tubes.labels) == {"uncovered"}
