"""Which runs train and which are tested."""

import numpy as np
import pytest

from fleet_bus.errors import UsageError
from fleet_bus.messages import StateFlag, parse_profile
from fleet_lab.evaluation.runs import choose, cut, keep, list_runs
from fleet_lab.evaluation.trials import linked, plan_trials
from tests.fleet_lab.wavy import wavy

PROFILE = parse_profile(
    {
        "class": "wavy",
        "state": {"x": "m", "y": "m", "yaw": {"unit": "rad", "angle": True}, "v": "m/s"},
        "inputs": {"steering": "rad", "velocity": "m/s"},
        "sample_time": 0.05,
        "frame": "body",
        "future_inputs": "learned",
        "roles": {"position": ["x", "y"], "heading": "yaw", "speed": "v", "steering": "steering"},
        "window": 400,
        "confidence": 0.9,
    }
)


@pytest.mark.parametrize(
    ("wanted", "taken"),
    [
        ("even", [0, 2, 4, 6]),
        ("odd", [1, 3, 5]),
        ("first:0.6", [0, 1, 2, 3]),
        ("last:0.3", [5, 6]),
        ("0-1, 5", [0, 1, 5]),
        ("3", [3]),
    ],
)
def test_runs_are_chosen_by_order(wanted: str, taken: list[int]) -> None:
    runs = list_runs([wavy(300, runs=3), wavy(400, runs=4)], PROFILE)
    assert np.flatnonzero(choose(runs, wanted, "--train-runs")).tolist() == taken


def test_runs_are_chosen_by_speed() -> None:
    runs = list_runs([wavy(600, runs=6)], PROFILE)
    slow, fast = (choose(runs, f"{which}:0.5", "--train-runs") for which in ("slow", "fast"))
    assert (slow ^ fast).all()
    speed = np.array([run.speed for run in runs])
    assert speed[slow].max() < speed[fast].min()


@pytest.mark.parametrize("wanted", ["some", "7", "2-9", "first:2", "first:0.0001", ""])
def test_runs_that_are_none_are_refused(wanted: str) -> None:
    runs = list_runs([wavy(300, runs=3)], PROFILE)
    with pytest.raises(UsageError, match="--test-runs"):
        choose(runs, wanted, "--test-runs")


def test_segments_are_cut_and_chosen_without_loss() -> None:
    recording = cut(wavy(300, runs=2), 2.0)
    lengths = [rows.stop - rows.start for rows in recording.segments()]
    assert lengths == [40, 40, 40, 30] * 2
    runs = list_runs([recording], PROFILE)
    odd = choose(runs, "odd", "--train-runs")
    both = [keep([recording], runs, mask)[0] for mask in (odd, ~odd)]
    assert sorted(np.concatenate([part.t for part in both])) == recording.t.tolist()
    assert set(both[0].segment).isdisjoint(both[1].segment)
    assert keep([recording], runs, np.zeros(len(runs), dtype=bool)) == []


def test_without_training_runs_the_first_part_trains() -> None:
    (trial,) = plan_trials([wavy(300)], PROFILE)
    assert (trial.training, trial.first, len(trial.tested)) == ([], 120, 300)


def test_training_comes_before_what_is_tested() -> None:
    trials = plan_trials([wavy(300, runs=3), wavy(400, runs=4)], PROFILE, train_runs="even")
    assert [len(trial.tested) for trial in trials] == [100, 200]
    for trial in trials:
        assert len(trial.training) == 400
        stamps = [sample.t for sample in (*trial.training, *trial.tested)]
        assert stamps == sorted(stamps)
        keys = {(sample.epoch, sample.seq) for sample in (*trial.training, *trial.tested)}
        assert len(keys) == len(stamps)
        begins = [bool(s.flags & StateFlag.NEW_TRAJECTORY) for s in trial.tested]
        assert sum(begins) == len(set(trial.run.tolist()))
        follows = linked(PROFILE, trial.tested)
        assert (follows == ~np.array(begins)).all()


def test_runs_that_train_are_not_tested() -> None:
    recordings = [wavy(300, runs=3)]
    with pytest.raises(UsageError, match="that train"):
        plan_trials(recordings, PROFILE, train_runs="even", test_runs="0")
    with pytest.raises(UsageError, match="none is left"):
        plan_trials(recordings, PROFILE, train_runs="0-2")
