"""What the positions say about the other columns: whether speed, heading and stamps agree with them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.units import size
from reach_server.numeric.types import FloatArray
from vehicle_agent.recording import Recording

#: Samples that a chord spans: short ones say most in turns, long ones most where the position is noisy.
SPANS: Final = (5, 20, 80)
#: Chords that must be there to say anything.
_LEAST_CHORDS: Final = 20
#: How many times as long as what noise makes of it a chord must be.
_OVER_NOISE: Final = 5.0
#: Mean resultant length from which directions agree, and by how much, rad, they may be off on average.
_AGREES: Final = 0.8
_STRAYS: Final = 0.5
_OFF: Final = 0.35


@dataclass(frozen=True, slots=True)
class _Chords:
    """Chords of one span, those of the vehicle in motion: their vectors (K, 2) in m, the number of their recording and
    of the first sample (K,)."""

    span: int
    vector: FloatArray
    recording: NDArray[np.intp]
    first: NDArray[np.intp]


def _column(recording: Recording, name: str) -> FloatArray:
    return recording.x[:, recording.state_names.index(name)]


def _scale(recording: Recording, name: str) -> float:
    """How many of m, s and rad the unit of a column is; 1 where it is not known."""
    return size(recording.state_units[recording.state_names.index(name)]) or 1.0


def _chords(recordings: Sequence[Recording], position: Sequence[str], span: int) -> _Chords | None:
    vectors, number, first, jitter = [], [], [], []
    for i, recording in enumerate(recordings):
        place = np.column_stack([_scale(recording, name) * _column(recording, name) for name in position])
        for rows in recording.segments():
            begin = np.arange(rows.start, rows.stop - span, max(span // 2, 1))
            vectors.append(place[begin + span] - place[begin])
            number.append(np.full(len(begin), i))
            first.append(begin)
            jitter.append(np.abs(np.diff(place[rows], 2, axis=0)).max(axis=1))
    vector = np.concatenate(vectors) if vectors else np.zeros((0, 2))
    if len(vector) < _LEAST_CHORDS:
        return None
    length = np.linalg.norm(vector, axis=1)
    moving = length >= 0.5 * np.quantile(length, 0.9)
    noise = float(np.median(np.concatenate(jitter)))
    if not moving.any() or not 0 < np.median(length[moving]) < math.inf:
        return None
    if np.median(length[moving]) < _OVER_NOISE * noise:
        return None
    return _Chords(span, vector[moving], np.concatenate(number)[moving], np.concatenate(first)[moving])


@np.errstate(all="ignore")  # What overflows says nothing.
def agreement(recordings: Sequence[Recording], position: Sequence[str], speed: str) -> float | None:
    """How far the position moves, as a part of what the speed says (median of chords in motion, in the units recorded);
    None where it does not move, or too little is there. Of the spans that say anything the one nearest to 1."""
    ratios = []
    for chords in (_chords(recordings, position, span) for span in SPANS):
        if chords is None:
            continue
        way = np.zeros(len(chords.vector))
        for i, recording in enumerate(recordings):
            v, of = np.abs(_column(recording, speed)) * _scale(recording, speed), chords.recording == i
            if not of.any():
                continue
            # Stamps of another segment may go back; no chord spans two segments.
            run = np.concatenate([[0.0], np.cumsum(v[:-1] * np.abs(np.diff(recording.t)))])
            way[of] = run[chords.first[of] + chords.span] - run[chords.first[of]]
        if (way > 0).sum() >= _LEAST_CHORDS:
            ratios.append(float(np.median(np.linalg.norm(chords.vector[way > 0], axis=1) / way[way > 0])))
    ratios = [ratio for ratio in ratios if 0 < ratio < math.inf]
    return min(ratios, key=lambda ratio: abs(math.log(ratio))) if ratios else None


@np.errstate(all="ignore")
def heading_problem(recordings: Sequence[Recording], position: Sequence[str], heading: str) -> tuple[str, bool] | None:
    """What a heading seems to be that does not follow the motion as an angle in rad, counter-clockwise from the first
    position to the second, forwards or backwards; whether that is sure. None where it agrees or nothing moves."""
    best: tuple[str, bool] | None = None
    for chords in (_chords(recordings, position, span) for span in SPANS):
        if chords is None:
            continue
        angle = np.zeros(len(chords.vector))
        for i, recording in enumerate(recordings):
            of = chords.recording == i
            angle[of] = _column(recording, heading)[chords.first[of] + chords.span // 2]
        course = np.arctan2(chords.vector[:, 1], chords.vector[:, 0])
        found = _verdict(angle, course)
        if found is None:
            return None
        best = found if best is None or (found[1] and not best[1]) else best
    return best


def _verdict(angle: FloatArray, course: FloatArray) -> tuple[str, bool] | None:
    def fit(candidate: FloatArray) -> tuple[float, float]:
        # Twice the angle: a vehicle may go backwards.
        mean = np.exp(2j * (candidate - course)).mean()
        return float(np.abs(mean)), float(np.angle(mean)) / 2

    together, off = fit(angle)
    if together >= _AGREES and abs(off) <= _OFF:
        return None
    in_radians, off_degrees = fit(np.deg2rad(angle))
    if in_radians >= _AGREES and abs(off_degrees) <= _OFF and np.abs(angle).max() > 2 * math.pi:
        return "in degrees", True
    if together >= _AGREES:
        return f"{math.degrees(off):+.0f}° off the direction of motion", False
    if fit(-angle)[0] >= _AGREES:
        return "clockwise", True
    if fit(np.deg2rad(-angle))[0] >= _AGREES and np.abs(angle).max() > 2 * math.pi:
        return "clockwise and in degrees", True
    return ("unlike the direction of motion", False) if together < _STRAYS else None
