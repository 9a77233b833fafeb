"""The engine offline over recordings: coverage, area and time, one method beside another."""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import RecordingError
from fleet_bus.messages import StateFlag, StateSample, VehicleProfile
from reach_server import audit
from reach_server.engine import Engine, KnownInputs
from reach_server.factor_sets import join_sets
from reach_server.results import Tubes
from reach_server.windows import SampleBatch
from vehicle_agent.recording import Recording
from vehicle_agent.sources import RecordingSource

#: Part of a recording that trains when no training recordings are named, at most one window of it.
TRAINING_PART = 0.4


@dataclass(frozen=True, slots=True)
class StepFigures:
    """Figures of one step of the horizon."""

    step: int
    checked: int
    inside: int
    area_mean: float
    area_median: float


@dataclass(frozen=True, slots=True)
class MethodFigures:
    """Figures of one method over all recordings."""

    steps: tuple[StepFigures, ...]
    update_us_median: float
    label_counts: dict[str, int]


@dataclass(frozen=True, slots=True)
class _Progress:
    tell: Callable[[str, int, int], None] | None
    method: str
    base: int
    total: int

    def __call__(self, done: int) -> None:
        if self.tell is not None:
            self.tell(self.method, self.base + done, self.total)


@dataclass(slots=True)
class _Tally:
    inside: list[NDArray[np.bool_]] = field(default_factory=list)
    checked: list[NDArray[np.bool_]] = field(default_factory=list)
    area: list[NDArray[np.float64]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    labels: Counter[str] = field(default_factory=Counter)


def evaluate(
    recordings: Sequence[Recording],
    profile: VehicleProfile,
    *,
    training: Sequence[Recording] = (),
    methods: Sequence[str] = ("paper", "default"),
    horizon: int | None = None,
    inputs: str = "recorded",
    progress: Callable[[str, int, int], None] | None = None,
) -> dict[str, MethodFigures]:
    """Figures by method.

    Works as operation does: the window starts with the training data (the recordings named, else the first part of
    each recording) and rolls on over the tested samples, each predicted before it enters. A measured state counts as
    inside when it lies in the predicted set, enlarged by the measurement noise where the set speaks about the true
    state. With ``inputs="recorded"`` the later inputs are taken as a known plan. ``progress`` is called with method,
    samples done and samples in all.
    """
    steps = horizon or profile.horizon
    figures = {}
    prepared = [_samples(recording.select(profile)) for recording in recordings]
    trained = [sample for recording in training for sample in _samples(recording.select(profile))]
    if inputs != "recorded":
        profile = profile.model_validate({**profile.model_dump(by_alias=True), "future_inputs": inputs})
    for method in methods:
        tally = _Tally()
        total = sum(len(samples) for samples in prepared)
        done = 0
        for samples in prepared:
            split = 0 if trained else min(int(TRAINING_PART * len(samples)), profile.window)
            engine = Engine(profile, method=method, horizon=steps, planned=inputs == "recorded")
            slot = engine.add("vehicle")
            engine.append(SampleBatch.of(slot, _renumbered(trained or samples[:split])))
            report = _Progress(progress, method, done, total)
            _roll(engine, samples, split, tally, steps, inputs == "recorded", report)
            done += len(samples)
        figures[method] = _figures(tally, steps)
    return figures


def as_json(
    figures: dict[str, MethodFigures], recordings: Sequence[str], profile: VehicleProfile, horizon: int
) -> dict[str, object]:
    """The document of ``fleet evaluate --json``."""
    methods = {name: {**asdict(f), "steps": [asdict(step) for step in f.steps]} for name, f in figures.items()}
    return {
        "recordings": list(recordings),
        "profile": profile.vehicle_class,
        "horizon": horizon,
        "methods": methods,
    }


def _samples(recording: Recording) -> list[StateSample]:
    readings = RecordingSource(recording)
    return [
        StateSample(1, seq, 1_000_000_000 + reading.t, reading.measured, reading.u, reading.flags)
        for seq, reading in enumerate(readings)
    ]


def _renumbered(samples: Sequence[StateSample]) -> list[StateSample]:
    """Training samples as an earlier start of the agent, so that they are older than every tested one."""
    return [
        StateSample(0, seq, 1 + seq if sample.t <= 0 else sample.t, sample.x, sample.u, sample.flags)
        for seq, sample in enumerate(_in_order(samples))
    ]


def _in_order(samples: Sequence[StateSample]) -> list[StateSample]:
    """The samples with stamps that go on from one recording to the next."""
    ordered: list[StateSample] = []
    shift = 0
    for sample in samples:
        if ordered and sample.seq == 0:
            shift = ordered[-1].t + 10**9 - sample.t
        ordered.append(StateSample(0, sample.seq, sample.t + shift, sample.x, sample.u, sample.flags))
    return ordered


def _roll(
    engine: Engine,
    samples: list[StateSample],
    first: int,
    tally: _Tally,
    horizon: int,
    planned: bool,
    progress: "_Progress",
) -> None:
    """Predict from every sample, then let it enter the window; check the predictions at the end."""
    linked = _linked(engine.profile, samples)
    predicted: list[tuple[int, Tubes]] = []
    for k in range(first, len(samples)):
        batch = SampleBatch.of(0, [samples[k]])
        exactly = np.zeros((1, engine.layout.m))
        known = KnownInputs(_plan(samples, k, horizon), exactly) if planned else None
        began = time.perf_counter()
        tubes = engine.step(batch, known)
        if tubes.vehicles:
            tally.seconds.append(time.perf_counter() - began)
            tally.labels[str(tubes.labels[0])] += 1
            predicted.append((k, tubes))
        if k % 50 == 0:
            progress(k + 1)
    progress(len(samples))
    if not predicted:
        return
    measurement = engine.noise_of_claim
    rows = np.array([k for k, _ in predicted])
    inside = np.zeros((len(rows), horizon), dtype=bool)
    checked = np.zeros((len(rows), horizon), dtype=bool)
    for h in range(1, horizon + 1):
        reached = np.array([k + h < len(samples) and all(linked[k + 1 : k + h + 1]) for k in rows])
        checked[:, h - 1] = reached
        which = np.flatnonzero(reached)
        for part in np.array_split(which, max(1, len(which) // 500)):
            if len(part):
                sets = join_sets([predicted[i][1].steps[h - 1] for i in part])
                y = np.stack([samples[rows[i] + h].x for i in part])
                inside[part, h - 1], _ = audit.inside(sets, measurement, y, engine.layout.angles)
    tally.inside.append(inside)
    tally.checked.append(checked)
    tally.area.append(np.stack([tubes.area[0] for _, tubes in predicted]))


def _linked(profile: VehicleProfile, samples: Sequence[StateSample]) -> list[bool]:
    """Whether each sample follows the one before it within the profile's tolerance."""
    slack = profile.tolerance * profile.sample_time_ns
    linked = [False]
    for before, after in pairwise(samples):
        new = bool(after.flags & StateFlag.NEW_TRAJECTORY)
        linked.append(not new and abs(after.t - before.t - profile.sample_time_ns) <= slack)
    return linked


def _plan(samples: Sequence[StateSample], k: int, horizon: int) -> NDArray[np.float64]:
    """Inputs (1, N - 1, m) of the coming samples; the last known one goes on where the recording ends."""
    plan = []
    last = samples[k].u
    for step in range(1, horizon):
        if k + step < len(samples) and not samples[k + step].flags & StateFlag.INPUT_MISSING:
            last = samples[k + step].u
        plan.append(last)
    return np.array(plan).reshape(1, horizon - 1, len(samples[k].u))


def _figures(tally: _Tally, horizon: int) -> MethodFigures:
    if not tally.inside:
        raise RecordingError(
            "no sample could be predicted: the recordings are too short for the window, or hardly any sample interval "
            "is what the profile says; give more training data with --train, or correct sample_time and tolerance"
        )
    inside, checked = np.concatenate(tally.inside), np.concatenate(tally.checked)
    area = np.concatenate(tally.area)
    steps = []
    for h in range(horizon):
        rows = checked[:, h]
        areas = area[rows, h] if rows.any() else np.zeros(1)
        steps.append(
            StepFigures(
                h + 1,
                int(rows.sum()),
                int((inside[:, h] & rows).sum()),
                float(areas.mean()),
                float(np.median(areas)),
            )
        )
    return MethodFigures(tuple(steps), float(np.median(tally.seconds) * 1e6), dict(tally.labels))
