"""Ridge regression of all steps at once against one of each step."""

from itertools import pairwise

import numpy as np
import pytest

from reach_server.data.regressors import RegressorSpec
from reach_server.models.conformal import features, ridge
from reach_server.models.conformal.spec import FeatureSpec
from reach_server.numeric.types import FloatArray
from tests.reach_server.models.conformal.streams import CAR, Stream, batch_of, drive, slow_features
from tests.reach_server.models.conformal.streams import slow_increment as increment

SPEC = FeatureSpec.of(CAR, RegressorSpec.of(CAR), CAR.horizon, planned=True)
BEGIN = ridge.first_columns(SPEC)


def data(rows: int, seed: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(rows, SPEC.total)) * rng.uniform(0.5, 3.0, SPEC.total)
    z[:, 0] = 1.0
    return z, rng.normal(size=(rows, SPEC.horizon * SPEC.n))


def summed(z: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    gram, cross = np.zeros((SPEC.total, SPEC.total)), np.zeros((SPEC.total, y.shape[1]))
    for k in range(len(z)):
        ridge.add(z[k], y[k], 1.0, gram, cross)
    return gram, cross


@pytest.mark.parametrize("strength", [1e-4, 0.1])
def test_every_step_is_the_ridge_regression_on_its_own_features(strength: float) -> None:
    z, y = data(150, 0)
    gram, cross = summed(z, y)
    lower, matrix = np.empty_like(gram), np.empty_like(cross)
    ridge.factor(gram, strength, lower)
    ridge.solve(lower, cross, BEGIN, matrix)
    spread = np.maximum(((z - z.mean(axis=0)) ** 2).sum(axis=0), len(z))
    spread[0] = 0.0
    for h in range(SPEC.horizon):
        size = SPEC.base + h * SPEC.later
        front = z[:, :size]
        columns = slice(h * SPEC.n, (h + 1) * SPEC.n)
        wanted = np.linalg.solve(front.T @ front + strength * np.diag(spread[:size]), front.T @ y[:, columns])
        np.testing.assert_allclose(matrix[:size, columns], wanted, rtol=1e-7, atol=1e-9)
        np.testing.assert_array_equal(matrix[size:, columns], 0.0)
    out = np.empty(y.shape[1])
    ridge.increments_of(z[0], matrix, BEGIN, out)
    np.testing.assert_allclose(out, z[0] @ matrix, rtol=1e-9, atol=1e-12)


def test_features_that_do_not_vary_do_no_harm() -> None:
    z, y = data(100, 1)
    z[:, 3] = 0.0
    z[:, 5] = z[:, 4]
    gram, cross = summed(z, y)
    lower, matrix = np.empty_like(gram), np.empty_like(cross)
    ridge.factor(gram, 1e-4, lower)
    ridge.solve(lower, cross, BEGIN, matrix)
    assert np.isfinite(matrix).all()
    assert np.abs(matrix).max() < 10
    np.testing.assert_allclose(matrix[4], matrix[5], atol=1e-6)


@pytest.mark.parametrize("planned", [False, True])
def test_sums_carried_on_are_those_of_the_window(planned: bool) -> None:
    """Fitted once, carried over three windows with gaps: what has entered and left is what is there."""
    profile = CAR.model_copy(update={"window": 250})
    stream = Stream(profile, planned=planned)
    spec = stream.spec
    x, u = drive(1300, 3)
    u[700] = np.nan
    x[[400, 850]] += 0.5
    parts = [0, 240, *range(241, 1300)]
    for a, b in pairwise(parts):
        first = a + (3 if a > 500 else 0)  # a gap in the numbers
        stream.take(batch_of(x[a:b], u[a:b], profile, first=first))
        stream.models._renewal[:] = 10**9
        if stream.models.ready(stream.slots).all() and stream.models.known(stream.slots).all():
            stream.models.predict(stream.slots, u[None, b : b + spec.horizon - 1] if b < 1298 else u[None, :2])
    assert stream.models.ready(stream.slots).all()
    model, count = stream.models._model, int(stream.window.count[0])
    assert count - model.newest[0] - spec.horizon < 10
    assert model.oldest[0] > 900
    ring = stream.window.arrays()
    size, total = stream.window.size, 0
    gram, cross = np.zeros((spec.total, spec.total)), np.zeros((spec.total, spec.horizon * spec.n))
    for number in range(model.oldest[0], model.newest[0]):
        if not features.usable(ring.run[0], ring.input_known[0], ring.gated[0], number, spec):
            continue
        order = np.arange(number - spec.reach, number + spec.horizon + 1) % size
        t, states, inputs = ring.t[0, order], ring.x[0, order], ring.u[0, order]
        z = (slow_features(t, states, inputs, spec.reach, spec) - model.mean[0]) / model.scale[0]
        y = np.concatenate([increment(t, states, spec.reach + h, spec) for h in range(spec.horizon)])
        gram += np.outer(z, z)
        cross += np.outer(z, y)
        total += 1
    assert model.data[0] == total > 150
    np.testing.assert_allclose(model.gram[0], np.tril(gram), rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(model.cross[0], cross, rtol=1e-5, atol=1e-5)
