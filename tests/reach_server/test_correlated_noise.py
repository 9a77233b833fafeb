"""A correlated noise set: every component of the residual hull must lean on the same datum."""

import numpy as np
import pytest

from reach_server.model import Model, residual_set
from reach_server.sets import Zonotope


@pytest.mark.parametrize("membership", [False, True])
def test_a_value_that_agrees_with_all_data_is_kept(membership: bool) -> None:
    # e_1 depends on the first regressor only, e_2 on the second; each datum shares one regressor with the query.
    z = np.array([[[0.0, 1.0], [1.0, 0.0]]])
    slope = np.array([[[10.0, 0.0], [0.0, 10.0]]])
    segment = np.array([[[0.9], [0.9]]])
    zero = np.zeros((1, 2))
    model = Model(
        np.zeros((1, 2, 3)), z, np.zeros((1, 2, 2)), zero, zero, segment, slope, zero,
        np.array([False]), np.zeros((1, 1, 2)), zero,
    )  # fmt: skip
    bound = residual_set(model, zero, zero, membership=membership)
    assert Zonotope(bound.center, bound.generators).contains_point(np.array([[0.9, -0.9]])).all()
