"""Runs of recordings: which of them to take, and how long ones are cut."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import UsageError
from fleet_bus.messages import VehicleProfile
from vehicle_agent.recording import Recording

CHOICES: Final = "even, odd, first:0.6, last:0.4, slow:0.5, fast:0.5, or numbers such as 0-9,12"

_PART: Final = re.compile(r"(first|last|slow|fast)(?::(0?\.\d+|1(?:\.0+)?))?")
_NUMBERS: Final = re.compile(r"\d+(?:-\d+)?(?:,\d+(?:-\d+)?)*")


@dataclass(frozen=True, slots=True)
class Run:
    """A segment of a recording: ``number`` is the one it has there, ``speed`` its mean speed."""

    recording: int
    number: int
    rows: slice
    speed: float


def list_runs(recordings: Sequence[Recording], profile: VehicleProfile) -> list[Run]:
    """The runs of some recordings (columns as in the profile), in order."""
    return [
        Run(i, int(recording.segment[rows.start]), rows, _speed(recording, rows, profile))
        for i, recording in enumerate(recordings)
        for rows in recording.segments()
    ]


def cut(recording: Recording, seconds: float) -> Recording:
    """The recording with each segment cut into runs of at most ``seconds``, numbered from 0."""
    segment = np.zeros(len(recording.t), dtype=np.int64)
    begin = 0
    for rows in recording.segments():
        piece = ((recording.t[rows] - recording.t[rows.start]) // seconds).astype(np.int64)
        # Pauses may leave pieces empty.
        _, piece = np.unique(piece, return_inverse=True)
        segment[rows] = begin + piece
        begin = int(segment[rows][-1]) + 1
    return replace(recording, segment=segment)


def choose(runs: Sequence[Run], wanted: str, option: str) -> NDArray[np.bool_]:
    """Mask of the runs that ``wanted`` names; numbers, even and odd count the runs of all recordings from 0.

    ``slow`` and ``fast`` take the part of the runs with the lowest and highest mean speed. Raises ``UsageError``
    naming ``option`` where nothing, or nothing that is there, is named.
    """
    count = len(runs)
    number = np.arange(count)
    text = wanted.replace(" ", "")
    if text in ("even", "odd"):
        mask = np.asarray(number % 2 == (text == "odd"))
    elif match := _PART.fullmatch(text):
        size = round(float(match[2] or 0.5) * count)
        order = number if match[1] in ("first", "last") else np.argsort([run.speed for run in runs], kind="stable")
        taken = order[:size] if match[1] in ("first", "slow") else order[count - size :]
        mask = np.isin(number, taken)
    elif _NUMBERS.fullmatch(text):
        mask = np.zeros(count, dtype=bool)
        for part in text.split(","):
            first, _, last = part.partition("-")
            if int(last or first) >= count:
                raise UsageError(f"{option} {wanted!r}: there are runs 0 to {count - 1} only")
            mask[int(first) : int(last or first) + 1] = True
    else:
        raise UsageError(f"{option} {wanted!r} is not understood: write {CHOICES}")
    if not mask.any():
        hint = "; cut long ones with --run-seconds" if count < 4 else ""
        raise UsageError(f"{option} {wanted!r} names none of the {count} runs{hint}")
    return mask


def keep(recordings: Sequence[Recording], runs: Sequence[Run], mask: NDArray[np.bool_]) -> list[Recording]:
    """The recordings with the masked runs only; those that keep none are left out."""
    kept = []
    for i, recording in enumerate(recordings):
        rows = np.zeros(len(recording.t), dtype=bool)
        for run in (run for run, taken in zip(runs, mask, strict=True) if taken and run.recording == i):
            rows[run.rows] = True
        if rows.any():
            columns = {name: getattr(recording, name)[rows] for name in ("t", "x", "u", "segment")}
            kept.append(replace(recording, **columns))
    return kept


def _speed(recording: Recording, rows: slice, profile: VehicleProfile) -> float:
    """Mean of the speed state, else distance over time."""
    x = recording.x[rows]
    if profile.roles.speed is not None:
        return float(np.abs(x[:, profile.state_names.index(profile.roles.speed)]).mean())
    duration = float(recording.t[rows][-1] - recording.t[rows][0])
    way = np.linalg.norm(np.diff(x[:, list(profile.position)], axis=0), axis=1).sum()
    return float(way) / duration if duration > 0 else 0.0
