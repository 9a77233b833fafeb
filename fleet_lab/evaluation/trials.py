"""What an evaluation streams: training samples first, then the tested ones."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import UsageError
from fleet_bus.messages import StateFlag, StateSample, VehicleProfile
from fleet_lab.evaluation.runs import choose, cut, keep, list_runs
from vehicle_agent.recording import Recording
from vehicle_agent.sources import PAUSE_NS, RecordingSource

#: Part of a recording that trains when nothing else is named, at most one window of it.
TRAINING_PART: Final = 0.4


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One vehicle: ``training`` samples, then ``tested`` ones with the number of their ``run`` (T,) in ``name``.

    Tested samples before ``first`` only fill the window.
    """

    name: str
    training: list[StateSample]
    tested: list[StateSample]
    run: NDArray[np.int64]
    first: int = 0


def plan_trials(
    recordings: Sequence[Recording],
    profile: VehicleProfile,
    *,
    training: Sequence[Recording] = (),
    train_runs: str | None = None,
    test_runs: str | None = None,
    run_seconds: float | None = None,
) -> list[Trial]:
    """One trial a recording.

    It trains on the ``training`` recordings and on the runs (of all ``recordings``) that ``train_runs`` names; where
    neither is given, on the first part of itself. It is tested on what ``test_runs`` names, else on all runs that do
    not train. With ``run_seconds`` longer segments are cut into runs first. Raises ``UsageError`` for runs that are
    not there, or that train and are tested, ``RecordingError`` for columns that are not.
    """
    selected, trained = ([r.select(profile) for r in group] for group in (recordings, training))
    if run_seconds is not None:
        selected = [cut(recording, run_seconds) for recording in selected]
    runs = list_runs(selected, profile)
    trains = np.zeros(len(runs), dtype=bool)
    if train_runs is not None:
        trains = choose(runs, train_runs, "--train-runs")
        trained = [*trained, *keep(selected, runs, trains)]
    tests = ~trains
    if test_runs is not None:
        tests = choose(runs, test_runs, "--test-runs")
    if (tests & trains).any():
        raise UsageError(f"--test-runs {test_runs!r} names runs that train (--train-runs {train_runs!r})")
    if not tests.any():
        raise UsageError(f"--train-runs {train_runs!r} takes all {len(runs)} runs: none is left to be tested")
    return [_trial(recording, trained, profile) for recording in keep(selected, runs, tests)]


def _trial(recording: Recording, training: Sequence[Recording], profile: VehicleProfile) -> Trial:
    trained = samples(training, 0, PAUSE_NS)
    tested = samples([recording], 1, (trained[-1].t if trained else 0) + PAUSE_NS)
    if trained:
        return Trial(recording.name, trained, tested, recording.segment)
    split = min(int(TRAINING_PART * len(tested)), profile.window)
    return Trial(recording.name, trained, tested, recording.segment, split)


def samples(recordings: Sequence[Recording], epoch: int, begin: int) -> list[StateSample]:
    """The samples of recordings one after the other, stamps from ``begin`` ns on."""
    taken: list[StateSample] = []
    for recording in recordings:
        for reading in RecordingSource(recording):
            taken.append(
                StateSample(epoch, len(taken), begin + reading.t, reading.measured, reading.u, reading.flags)
            )  # fmt: skip
        begin = taken[-1].t + PAUSE_NS
    return taken


def linked(profile: VehicleProfile, tested: Sequence[StateSample]) -> NDArray[np.bool_]:
    """Whether each sample (T,) follows the one before it within the profile's tolerance."""
    t = np.array([sample.t for sample in tested])
    new = np.array([bool(sample.flags & StateFlag.NEW_TRAJECTORY) for sample in tested])
    follows = ~new
    follows[0] = False
    slack = profile.tolerance * profile.sample_time_ns
    follows[1:] &= np.abs(np.diff(t) - profile.sample_time_ns) <= slack
    return follows
