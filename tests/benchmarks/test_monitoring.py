"""Both sides of the monitoring benchmark, and a third one by brute force, agree on what is true of a drive."""

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.monitoring import QUICK_STEP_NS, Monitor, Task, different, follow, tasks
from side_info.stl.nnf import Conjunction, Finally, Globally, Literal, reach_ns
from tests.side_info.progression.readings import on_grid

VEHICLES = 30
TASKS = list(tasks(VEHICLES, QUICK_STEP_NS))


def truth(task: Task) -> NDArray[np.bool_]:
    return on_grid(task.holds, task.true, QUICK_STEP_NS)[:, 0]


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.name)
def test_all_three_agree(task: Task) -> None:
    expected = truth(task)
    assert 0 < expected.sum() < VEHICLES
    seconds, verdicts = follow(task, np.arange(VEHICLES))
    np.testing.assert_array_equal(verdicts, np.where(expected, 1, -1))
    assert len(seconds) == reach_ns(task.holds) // QUICK_STEP_NS + 1
    for vehicle in (int(np.argmax(expected)), int(np.argmin(expected))):
        _, robustness = Monitor(task.holds, QUICK_STEP_NS).follow(task.true[vehicle])
        assert (robustness > 0) == expected[vehicle]


def test_one_vehicle_alone_comes_to_the_same() -> None:
    task = TASKS[0]
    found = [int(follow(task, np.array([vehicle]))[1][0]) for vehicle in range(6)]
    np.testing.assert_array_equal(found, np.where(truth(task)[:6], 1, -1))


def test_the_peer_is_given_what_it_gets_right() -> None:
    """Equal subformulas get signals of their own: by the name of a node RTAMT would fill one buffer twice."""
    rng = np.random.default_rng(0)
    formula = Conjunction(
        (Globally(0, 3, Literal(0)), Finally(1, 3, Conjunction((Literal(0), Literal(1)))), Literal(1))
    )
    differ = 0
    for _ in range(40):
        true = rng.random((4, 2)) < 0.85
        _, robustness = Monitor(formula, 1).follow(true)
        differ += (robustness > 0) != bool(on_grid(formula, true[None])[0, 0])
    assert differ == 0


def test_equal_drives_are_counted_once() -> None:
    true = np.zeros((5, 3, 3), dtype=np.bool_)
    true[1, 2, 0] = true[3, 2, 0] = true[4, 0, 2] = True
    assert different(true) == 3
    assert different(true[..., :2]) == 2
