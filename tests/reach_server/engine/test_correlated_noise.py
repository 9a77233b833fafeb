"""Correlated noise: what sets lose to boxes, and what they must not lose to a mix of data."""

import numpy as np
import pytest

from fleet_bus.messages import Lipschitz
from reach_server.data.regressors import RegressorSpec, Transitions
from reach_server.models.residual_model import Model, NoiseBounds, ResidualSet, fit, residual_set, thin_directions
from reach_server.numeric.types import FloatArray
from reach_server.sets import Zonotope
from reach_server.sets.polygon import zonotope_area


def model_of(z: FloatArray, residual: FloatArray, noise: FloatArray, slope: FloatArray) -> Model:
    """A planar model M = 0 of one vehicle with data (T, p), residuals (T, 2) and generators (2, g) of N."""
    box = np.concatenate([np.zeros((2, 2)), noise], axis=1)[None]
    return Model(
        np.zeros((1, 2, 1 + z.shape[1])), np.ascontiguousarray(z.T[None]), np.ascontiguousarray(residual.T[None]),
        np.array([len(z)]), residual.min(axis=0)[None], residual.max(axis=0)[None], box, slope[None],
        np.zeros((1, z.shape[1])), thin_directions(box), np.array([False]), np.zeros((1, 2)),
    )  # fmt: skip


@pytest.mark.parametrize("membership", [False, True])
def test_a_value_that_agrees_with_all_data_is_kept(membership: bool) -> None:
    """Every component of the hull must lean on the same datum."""
    # e_1 depends on the first regressor only, e_2 on the second; each datum shares one regressor with the query.
    z = np.array([[0.0, 1.0], [1.0, 0.0]])
    model = model_of(z, np.zeros((2, 2)), np.array([[0.9], [0.9]]), 10 * np.eye(2))
    zero = np.zeros((1, 2))
    bound = residual_set(model, zero, zero, membership=membership)
    assert Zonotope(bound.center, bound.generators).contains_point(np.array([[0.9, -0.9]])).all()


def sets_of(seed: int, noise: FloatArray, spread: float) -> tuple[Model, ResidualSet, ResidualSet, FloatArray]:
    """Data of a known residual function near zero: hull, set membership, and the true value at the point asked for."""
    rng = np.random.default_rng(seed)
    slope = np.full((2, 2), 0.05)
    z = rng.uniform(-1, 1, (60, 2))
    residual = spread * np.sin(z) + rng.uniform(-1, 1, (60, noise.shape[1])) @ noise.T
    model = model_of(z, residual, noise, slope)
    point = rng.uniform(-0.5, 0.5, (1, 2))
    hull, small = (residual_set(model, point, np.zeros((1, 2)), membership=m) for m in (False, True))
    return model, hull, small, spread * np.sin(point)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("noise", [[[1.0], [1.0]], [[1.0, 0.05], [1.0, -0.05]], [[1.0, 0.3], [-0.2, 0.6]]])
def test_directions_make_set_membership_smaller_than_the_hull_where_a_box_is_larger(
    seed: int, noise: list[list[float]]
) -> None:
    model, hull, small, value = sets_of(seed, np.array(noise), 0.04)
    assert not small.contradicted.any()
    areas = [float(zonotope_area(found.generators)[0]) for found in (hull, small)]
    assert areas[1] <= areas[0] * (1 + 1e-12)
    assert Zonotope(small.center, small.generators).contains_point(value).all()
    # What set membership comes to in the axes alone.
    without = Model(**{name: getattr(model, name) for name in Model.__slots__} | {"directions": np.zeros((1, 0, 2))})
    box = residual_set(without, np.zeros((1, 2)), np.zeros((1, 2)), membership=True)
    assert areas[1] <= float(zonotope_area(box.generators)[0]) * (1 + 1e-9)
    if noise[0] == [1.0]:
        assert areas[1] < 0.8 * areas[0]


def test_directions_are_those_across_long_generators() -> None:
    segment = np.concatenate([np.diag([0.01, 0.01]), [[1.0], [2.0]]], axis=1)[None]
    found = thin_directions(segment)[0]
    across = found[0] / np.linalg.norm(found[0])
    assert abs(across @ [2.0, -1.0]) == pytest.approx(np.sqrt(5))
    box = np.concatenate([np.eye(2), np.zeros((2, 1))], axis=1)[None]
    assert not thin_directions(box).any()
    assert thin_directions(np.eye(3)[None]).shape == (1, 0, 3)


def test_columns_along_an_axis_are_part_of_the_box() -> None:
    layout = RegressorSpec(2, 0, 0, None, (0, 1), ())
    rng = np.random.default_rng(0)
    z = rng.normal(size=(1, 30, 2))
    data = Transitions(z, z * 0.5, np.ones((1, 30), dtype=bool), z[:, -1])
    bounds = NoiseBounds(np.array([[0.1, 0.03], [0.0, 0.02]]), np.zeros((2, 0)))
    model = fit(data, layout, bounds, Lipschitz(matrix=[[1.0, 1.0], [1.0, 1.0]], of="residual"))
    assert model.noise[0, 0, 0] == pytest.approx(0.1)
    np.testing.assert_allclose(model.noise[0, 1, :2], 0.0, atol=1e-12)
    np.testing.assert_allclose(model.noise[0, :, 2], [0.03, 0.02])
    assert model.noise.shape == (1, 2, 3)
