"""The same drives through the engine of the reach server, with noise as a car of this kind has it."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import StateFlag, VehicleProfile, parse_profile
from fleet_lab.paper.drives import CAR, SAMPLE_TIME, Track, displacement_error
from fleet_lab.paper.formulas import Formula
from reach_server.audit import prediction_check as audit
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine
from reach_server.numeric.types import FloatArray
from reach_server.sets.raw import RawSets, join_sets
from side_info import Scenario

#: Half-widths of the measurement error: m, m, rad.
MEASURED: Final = (0.001, 0.001, 0.005)
#: m/s and m/s²: limits of the driven and of the free drives.
_SPEED: Final = 1.7
#: Samples from one prediction to the next.
STRIDE: Final = 10
_PAUSE: Final = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """Of V drives and K predictions each: areas (V, K) with and without side information, whether the true state lay in
    its set (V, K), seconds (K,) of an update of all drives, and the labels that were given."""

    area: FloatArray
    area_free: FloatArray
    inside: NDArray[np.bool_]
    inside_free: NDArray[np.bool_]
    seconds: FloatArray
    labels: tuple[str, ...]


def profile(cuts: str) -> VehicleProfile:
    """Position and heading, driven by a velocity vector; every bound follows from ``CAR`` and is given.

    f is linear but for what ``displacement_error`` bounds, which is process noise here, as is the heading's change of a
    sample: so its derivatives are known exactly.
    """
    moved = displacement_error(_SPEED)
    turned = SAMPLE_TIME * _SPEED * np.tan(CAR.steering_limit) / CAR.wheel_base + CAR.process_noise[2]
    slopes = [[1.0, 0, 0, SAMPLE_TIME, 0], [0, 1.0, 0, 0, SAMPLE_TIME], [0, 0, 1.0, 0, 0]]
    fields: dict[str, Any] = {
        "class": "paper",
        "state": {"x1": "m", "x2": "m", "yaw": {"unit": "rad", "angle": True}},
        "inputs": {name: {"unit": "m/s", "limits": [-_SPEED, _SPEED]} for name in ("v1", "v2")},
        "sample_time": SAMPLE_TIME,
        "frame": "world",
        "input_lags": 0,
        "window": 1000,
        "noise": {
            "process": {"box": [moved, moved, float(turned)], "origin": "given"},
            "measurement": {"box": list(MEASURED), "origin": "given"},
        },
        "lipschitz": {"lower": slopes, "upper": slopes, "origin": "given"},
        "future_inputs": "plan",
        "roles": {"position": ["x1", "x2"], "heading": "yaw"},
        "horizon": 1,
        "cuts": cuts,
    }
    return parse_profile(fields, "profile of the paper's car")


def drive(
    formula: Formula,
    tracks: list[Track],
    before: list[Track],
    seed: int,
    cuts: str,
    tell: Callable[[int, int], None],
) -> Outcome:
    """Single-step sets along some tracks of equal length; the data are the transitions of ``before``.

    ``tell`` is called with the steps done and those in all.
    """
    engine, rng = Engine(profile(cuts)), np.random.default_rng(seed)
    slots = [engine.add(track.name) for track in tracks]
    for slot in slots:
        engine.append(_history(slot, before, rng))
    engine.frozen = True
    stamp, steps = 1000 * _PAUSE, len(tracks[0].t) - 1
    scenario = Scenario.parse(formula.document())
    for track in tracks:
        engine.assign(track.name, scenario, stamp)
    true = np.stack([_states(track) for track in tracks])
    measured = true + rng.uniform(-1.0, 1.0, true.shape) * MEASURED
    inputs = np.stack([track.velocity for track in tracks])
    found, seconds, after = [], [], []
    for k in range(steps):
        batch = _batch(np.array(slots), 1, k, stamp + k * round(SAMPLE_TIME * 1e9), measured[:, k], inputs[:, k])
        # No tube begins at the sample that begins a trajectory.
        if (k - 1) % STRIDE:
            engine.append(batch)
            continue
        began = time.perf_counter()
        found.append(engine.step(batch))
        seconds.append(time.perf_counter() - began)
        after.append(true[:, k + 1])
        tell(k + 1, steps)
    sets, free = (join_sets([getattr(t, name)[0] for t in found]) for name in ("steps", "free"))
    truth, shape = np.concatenate(after), (len(found), len(tracks))
    return Outcome(
        np.concatenate([t.area for t in found], axis=1),
        np.concatenate([t.area_free for t in found], axis=1),
        _inside(sets, truth).reshape(shape).T,
        _inside(free, truth).reshape(shape).T,
        np.array(seconds),
        tuple(sorted({str(label) for t in found for label in t.labels})),
    )


def _inside(sets: RawSets, points: FloatArray) -> NDArray[np.bool_]:
    return audit.inside(sets, np.zeros((3, 0)), points, (2,))[0]


def _states(track: Track) -> FloatArray:
    return np.column_stack([track.position, track.heading])


def _history(slot: int, before: list[Track], rng: np.random.Generator) -> SampleBatch:
    parts, count, stamp = [], 0, _PAUSE
    for track in before:
        states = _states(track) + rng.uniform(-1.0, 1.0, (len(track.t), 3)) * MEASURED
        t = stamp + np.round(track.t * 1e9).astype(np.int64)
        flags = np.full(len(t), int(StateFlag.HISTORY), dtype=np.uint32)
        flags[0] |= int(StateFlag.NEW_TRAJECTORY)
        sequence = np.arange(count, count + len(t), dtype=np.uint64)
        rows = np.full(len(t), slot, dtype=np.intp)
        parts.append(SampleBatch(rows, np.zeros(len(t), np.uint64), sequence, t, flags, states, track.velocity))
        count, stamp = count + len(t), int(t[-1]) + _PAUSE
    return SampleBatch.join(parts)


def _batch(
    slots: NDArray[np.intp], epoch: int, k: int, stamp: int, states: FloatArray, inputs: FloatArray
) -> SampleBatch:
    count = len(slots)
    flag = int(StateFlag.NEW_TRAJECTORY) if k == 0 else 0
    return SampleBatch(
        slots, np.full(count, epoch, np.uint64), np.full(count, k, np.uint64), np.full(count, stamp, np.int64),
        np.full(count, flag, np.uint32), states, inputs,
    )  # fmt: skip
