"""Sources: order, stamps, due times and flags."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from fleet_bus.errors import UsageError
from fleet_bus.messages import StateFlag
from vehicle_agent.recording import Recording, load_recording
from vehicle_agent.route import load_route
from vehicle_agent.sources import PAUSE_NS, RecordingSource, SimulatedSource
from vehicle_agent.svea import SveaParameters

DATA = Path(__file__).parents[1] / "data" / "recordings"
DT = SveaParameters().dt_ns


def small_recording() -> Recording:
    return Recording(
        t=np.array([5.0, 5.1, 5.25, 0.0, 0.1]),
        x=np.arange(5.0)[:, None],
        u=np.array([[1.0, 2.0], [3.0, np.nan], [5.0, 6.0], [7.0, 8.0], [np.nan, np.nan]]),
        segment=np.array([3, 3, 3, 9, 9]),
        state_names=("x",),
        state_units=("m",),
        input_names=("a", "b"),
        input_units=("1", "1"),
    )


def test_a_recording_is_rebased_flagged_and_timed() -> None:
    readings = list(RecordingSource(small_recording(), speed=2.0))
    ms = 1_000_000
    assert [r.t for r in readings] == [0, 100 * ms, 250 * ms, 1250 * ms, 1350 * ms]
    assert [r.due for r in readings] == [r.t / 2e9 for r in readings]
    new, missing, none = StateFlag.NEW_TRAJECTORY, StateFlag.INPUT_MISSING, StateFlag.NONE
    assert [r.flags for r in readings] == [new, missing, none, new, missing]
    np.testing.assert_array_equal([r.u for r in readings], [[1, 2], [0, 0], [5, 6], [7, 8], [0, 0]])
    np.testing.assert_array_equal([r.measured[0] for r in readings], range(5))
    assert all(r.truth is None for r in readings)


def test_a_real_recording_replays() -> None:
    recording = load_recording(DATA / "fix_f1tenth_koopman.npz")
    readings = list(RecordingSource(recording))
    assert len(readings) == len(recording.t)
    flags = [reading.flags for reading in readings]
    assert flags.count(StateFlag.NEW_TRAJECTORY) == 41
    assert flags.count(StateFlag.INPUT_MISSING) == 41
    assert (np.diff([reading.t for reading in readings]) > 0).all()


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_a_speed_must_be_positive(speed: float) -> None:
    with pytest.raises(UsageError, match="must be positive"):
        RecordingSource(small_recording(), speed)


def test_a_simulated_car_has_a_past_a_drive_and_a_rest() -> None:
    source = SimulatedSource(load_route("roundabout"), seed=5, history=100)
    live = len(source.drive.truth)
    readings = list(itertools.islice(source, 100 + live + 50))
    past, drive, rest = readings[:100], readings[100 : 100 + live], readings[100 + live :]
    assert (source.history, source.sample_time, source.knows_truth) == (100, 0.05, True)

    assert all(StateFlag.HISTORY in r.flags and r.due == 0.0 for r in past)
    assert [StateFlag.NEW_TRAJECTORY in r.flags for r in past] == [True] + [False] * 99
    assert [r.t for r in past] == [-PAUSE_NS - (99 - k) * DT for k in range(100)]

    assert [r.flags for r in drive] == [StateFlag.NEW_TRAJECTORY] + [StateFlag.NONE] * (live - 1)
    assert [r.t for r in drive + rest] == [k * DT for k in range(live + 50)]
    assert [r.due for r in drive + rest] == [k * DT / 1e9 for k in range(live + 50)]
    assert all(r.flags == StateFlag.NONE for r in rest)
    np.testing.assert_array_equal(rest[-1].u, [0.0, 0.0])

    u = np.array([r.u for r in readings])
    assert (np.abs(np.diff(u, axis=0)) <= [0.15, 0.2]).all()
    assert all(r.truth is not None and np.isfinite(r.measured).all() for r in readings)


def test_without_history_the_drive_comes_first_and_iterating_starts_anew() -> None:
    source = SimulatedSource(load_route("roundabout"), seed=5, history=0)
    first, again = next(iter(source)), next(iter(source))
    assert first.flags == StateFlag.NEW_TRAJECTORY
    assert first.t == again.t == 0
    np.testing.assert_array_equal(first.measured, again.measured)
