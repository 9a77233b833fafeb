"""Reservoirs against a twin that measures all distances anew for each row."""

import numpy as np
import pytest

from reach_server.data.reservoir import Reservoir
from reach_server.numeric.types import FloatArray

ONE = np.array([0])


class Twin:
    """Rows of one vehicle, in the scale that came last but for changes of less than a factor of two."""

    def __init__(self, size: int) -> None:
        self.size, self.z, self.scale = size, np.zeros((0, 0)), np.zeros(0)

    def offer(self, z: FloatArray, scale: FloatArray) -> None:
        if not len(self.z):
            self.z, self.scale = z[None], scale
            return
        known = scale > 0
        same = np.array_equal(known, self.scale > 0)
        if not same or (np.abs(np.log2(scale[known] / self.scale[known])) > 1).any():
            self.scale = scale
        if len(self.z) < self.size:
            self.z = np.vstack([self.z, z])
            return
        distance = self.distances(self.z, self.z)
        np.fill_diagonal(distance, np.inf)
        worst = int(np.argmin(distance.min(axis=1)))
        others = np.delete(np.arange(self.size), worst)
        if len(others) and self.distances(z[None], self.z[others]).min() > distance[worst].min():
            self.z[worst] = z

    def distances(self, a: FloatArray, b: FloatArray) -> FloatArray:
        known = self.scale > 0
        difference = a[:, None, known] - b[None, :, known]
        return np.asarray((difference**2 * (1.0 / self.scale[known] ** 2)).sum(axis=-1))


def filled(size: int, p: int = 3) -> Reservoir:
    made = Reservoir(size, p, 2)
    made.grow(3)
    return made


@pytest.mark.parametrize("size", [1, 2, 7, 20])
@pytest.mark.parametrize("coarse", [False, True])
def test_the_rows_are_those_of_the_twin(size: int, coarse: bool) -> None:
    rng = np.random.default_rng(size)
    made, twin = filled(size), Twin(size)
    scale = np.array([1.0, 2.0, 0.0])
    for k in range(150):
        z = rng.normal(size=3) * [1.0, 2.0, 5.0]
        # On a grid many distances are equal, and many rows come twice.
        z = np.round(z) if coarse else z
        if k % 40 == 39:
            scale = scale * rng.uniform(0.3, 3.0, 3) if k % 80 == 39 else np.array([1.0, 1.0, 1.0])
        made.offer(ONE, z[None], np.array([[k, -k]], dtype=float), scale[None])
        twin.offer(z, scale)
        rows, target, held = made.rows(ONE)
        assert held[0] == len(twin.z)
        np.testing.assert_array_equal(rows[0, : held[0]], twin.z)
        np.testing.assert_array_equal(target[0, :, 0], -target[0, :, 1])
    assert made.held[1:].sum() == 0


def test_what_is_rare_stays() -> None:
    rng = np.random.default_rng(1)
    made = filled(20)
    usual = rng.normal(scale=0.1, size=(3000, 3))
    rare = np.array([[3.0, 0, 0], [0, -3.0, 0], [0, 0, 3.0]])
    z = np.concatenate([usual[:500], rare, usual[500:]])
    made.offer(np.zeros(len(z), dtype=np.intp), z, z[:, :2], np.ones((len(z), 3)))
    kept = made.z[0]
    for row in rare:
        assert (kept == row).all(axis=1).any()
    chosen = Twin(20)
    chosen.scale = np.ones(3)
    gaps, random = (chosen.distances(rows, rows) + 100 * np.eye(20) for rows in (kept, usual[:20]))
    assert gaps.min() > 4 * random.min()


def test_vehicles_do_not_meet_in_a_batch() -> None:
    rng = np.random.default_rng(2)
    z, target, scale = rng.normal(size=(300, 3)), rng.normal(size=(300, 2)), np.ones(3)
    together, apart = filled(5), [filled(5) for _ in range(3)]
    slots = rng.integers(0, 3, 300)
    together.offer(slots, z, target, scale)
    for slot, alone in enumerate(apart):
        mine = slots == slot
        alone.offer(np.zeros(int(mine.sum()), dtype=np.intp), z[mine], target[mine], scale)
        np.testing.assert_array_equal(together.z[slot], alone.z[0])
        np.testing.assert_array_equal(together.target[slot], alone.target[0])


def test_rows_that_are_no_numbers_are_passed_over() -> None:
    made = filled(4)
    made.offer(ONE, np.array([[0.0, np.nan, 0.0]]), np.zeros((1, 2)), np.ones((1, 3)))
    made.offer(ONE, np.zeros((1, 3)), np.array([[0.0, np.inf]]), np.ones((1, 3)))
    assert made.held[0] == 0
    assert made.revision[0] == 0


def test_a_cleared_vehicle_begins_anew() -> None:
    made = filled(2)
    for slot in (0, 1):
        made.offer(np.array([slot]), np.ones((1, 3)), np.ones((1, 2)), np.ones((1, 3)))
    made.clear(0)
    assert made.held.tolist() == [0, 1, 0]
    made.offer(ONE, np.full((1, 3), 2.0), np.ones((1, 2)), np.full((1, 3), 9.0))
    assert made.rows(ONE)[0][0, 0].tolist() == [2.0, 2.0, 2.0]


def test_a_reservoir_without_rows_takes_none() -> None:
    made = filled(0)
    made.offer(ONE, np.ones((1, 3)), np.ones((1, 2)), np.ones((1, 3)))
    assert made.held[0] == 0
