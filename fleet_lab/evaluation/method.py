"""Streams trials through the engine: each sample is predicted before it enters the window."""

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import StateFlag, StateSample, VehicleProfile
from fleet_lab.evaluation.figures import Checks, MethodFigures, Tally, Told, enlarged_area
from fleet_lab.evaluation.trials import Trial, linked
from reach_server.audit import prediction_check as audit
from reach_server.data.regressors import wrap
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine, PlannedInputs
from reach_server.engine.results import Tubes
from reach_server.numeric.checks import stack_columns
from reach_server.sets.raw import RawSets, join_sets

INPUTS: Final = ("recorded", "limits", "rate", "learned")
"""What may be taken as known about later inputs."""

#: Sets that are joined and checked at once.
_PART: Final = 500
_NUMBER: Final = re.compile(r"\d+")


@dataclass(frozen=True, slots=True)
class Settings:
    """How to evaluate.

    Attributes:
        methods: set side by side.
        horizon: steps; None for the profile's.
        inputs: what is known about later inputs, one of ``INPUTS``; with ``recorded`` those of the recording are a
            known plan.
        frozen: nothing is learned from tested samples; they only say where the vehicle is.
    """

    methods: tuple[str, ...] = ("paper", "default")
    horizon: int | None = None
    inputs: str = "recorded"
    frozen: bool = False


def evaluate(
    trials: Sequence[Trial],
    profile: VehicleProfile,
    settings: Settings,
    progress: Callable[[str, int, int], None] | None = None,
) -> dict[str, MethodFigures]:
    """Figures by method.

    Works as operation does: the window starts with the training samples and, unless ``frozen``, rolls on over the
    tested ones. A measured state counts as inside when it lies in the predicted set, enlarged by the measurement noise
    where the set speaks about the true state. ``progress`` is called with method, samples done and samples in all.
    """
    if settings.inputs != "recorded":
        profile = profile.model_validate({**profile.model_dump(by_alias=True), "future_inputs": settings.inputs})
    total = sum(len(trial.tested) for trial in trials)
    for method in settings.methods:
        # An unknown method is told before the work.
        _engine(profile, method, settings)
    figures = {}
    for method in settings.methods:
        tally, done = Tally(), 0
        for trial in trials:
            _stream(trial, profile, method, settings, tally, _Progress(progress, method, done, total))
            done += len(trial.tested)
        figures[method] = tally.figures(settings.horizon or profile.horizon, profile.confidence)
    return figures


@dataclass(frozen=True, slots=True)
class _Progress:
    tell: Callable[[str, int, int], None] | None
    method: str
    before: int
    total: int

    def __call__(self, done: int) -> None:
        if self.tell is not None:
            self.tell(self.method, self.before + done, self.total)


def _stream(
    trial: Trial, profile: VehicleProfile, method: str, settings: Settings, tally: Tally, tell: _Progress
) -> None:
    """Predict from every tested sample, then let it enter the window; check the predictions at the end."""
    planned = settings.inputs == "recorded"
    horizon = settings.horizon or profile.horizon
    engine = _engine(profile, method, settings)
    slot = engine.add("vehicle")
    if before := [*trial.training, *trial.tested[: trial.first]]:
        engine.append(SampleBatch.of(slot, before))
    tested = trial.tested
    exactly = np.zeros((1, len(profile.inputs)))
    engine.frozen = settings.frozen
    predicted: list[tuple[int, Tubes]] = []
    for k in range(trial.first, len(tested)):
        known = PlannedInputs(_plan(tested, k, horizon), exactly) if planned else None
        began = time.perf_counter()
        tubes = engine.step(SampleBatch.of(slot, tested[k : k + 1]), known)
        spent = time.perf_counter() - began
        tally.events += [Told(trial.name, k, str(e.kind), e.message) for e in tubes.events]
        # Before there are enough samples the sets may come from limits alone: no sets of this method.
        if engine.method in tubes.methods:
            tally.seconds.append(spent)
            tally.labels[str(tubes.labels[0])] += 1
            predicted.append((k, tubes))
        tally.waiting.update(_NUMBER.sub("…", reason) for reason in tubes.waiting.values())
        if k % 50 == 0:
            tell(k + 1)
    tell(len(tested))
    if predicted:
        tally.checks.append(_check(trial, engine, predicted))


def _engine(profile: VehicleProfile, method: str, settings: Settings) -> Engine:
    return Engine(profile, method=method, horizon=settings.horizon, planned=settings.inputs == "recorded")


def _plan(tested: Sequence[StateSample], k: int, horizon: int) -> NDArray[np.float64]:
    """Inputs (1, N - 1, m) of the coming samples; the last known one goes on where the recording ends."""
    plan = []
    last = tested[k].u
    for step in range(1, horizon):
        if k + step < len(tested) and not tested[k + step].flags & StateFlag.INPUT_MISSING:
            last = tested[k + step].u
        plan.append(last)
    return np.array(plan).reshape(1, horizon - 1, len(tested[k].u))


def _check(trial: Trial, engine: Engine, predicted: Sequence[tuple[int, Tubes]]) -> Checks:
    """The predictions held against what was measured; only along unbroken trajectories."""
    rows = np.array([k for k, _ in predicted])
    horizon = engine.horizon
    x = np.stack([sample.x for sample in trial.tested])
    angles = _angles(engine)
    # Links up to each sample: step h of a prediction is checked where the h samples after it are linked.
    follows = linked(engine.profile, trial.tested)
    breaks = np.concatenate([[0], np.cumsum(~follows)])
    shape = (len(rows), horizon)
    checked, inside = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    checked_area, offset = np.zeros(shape), np.zeros((*shape, x.shape[1]))
    generators: list[NDArray[np.float64] | None] = []
    for h in range(1, horizon + 1):
        last = np.minimum(rows + h, len(x) - 1)
        checked[:, h - 1] = (rows + h < len(x)) & (breaks[last + 1] == breaks[rows + 1])
        sets = join_sets([tubes.steps[h - 1] for _, tubes in predicted])
        offset[:, h - 1] = x[last] - sets.center
        for i in angles:
            offset[:, h - 1, i] = wrap(offset[:, h - 1, i])
        inside[:, h - 1] = _inside(sets, engine, x[last], checked[:, h - 1])
        enlarged = stack_columns(sets.generators, engine.noise_of_claim)
        checked_area[:, h - 1] = enlarged_area(enlarged, engine.profile.position)
        generators.append(enlarged if sets.matrix.shape[1] == 0 else None)
    area = np.stack([tubes.area[0] for _, tubes in predicted])
    return Checks(
        trial.name, rows, trial.run[rows], checked, inside, area, checked_area, offset, tuple(generators)
    )  # fmt: skip


def _angles(engine: Engine) -> tuple[int, ...]:
    return tuple(np.flatnonzero(engine.profile.angles).tolist())


def _inside(sets: RawSets, engine: Engine, y: NDArray[np.float64], wanted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether each state lies in its enlarged set, where wanted."""
    found = np.zeros(len(y), dtype=bool)
    which = np.flatnonzero(wanted)
    for part in np.array_split(which, max(1, len(which) // _PART)):
        if len(part):
            some = RawSets(sets.center[part], sets.generators[part], sets.matrix[part], sets.offset[part])
            found[part], _ = audit.inside(some, engine.noise_of_claim, y[part], _angles(engine))
    return found
