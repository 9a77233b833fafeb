"""Fitting to some runs and evaluating on the others: which bounds hold, and at what rate the sets do."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from fleet_bus.errors import RecordingError
from fleet_bus.messages import VehicleProfile, parse_profile
from fleet_lab.evaluation import MethodFigures, Settings, Trial, evaluate, plan_trials
from fleet_lab.evaluation.runs import choose, cut, keep, list_runs
from fleet_lab.evaluation.trials import samples
from fleet_lab.identification.bounds import FittedBounds, fitted_bounds
from fleet_lab.identification.doubts import too_little
from fleet_lab.identification.draft import round_up
from vehicle_agent.recording import Recording

#: Factors by which all noise is widened until enough held-out states lie inside, at every step of the horizon.
MARGINS: Final = (1.0, 1.25, 1.5, 2.0, 3.0)
#: Runs from which on every other one is held out; fewer are cut, and the last ones held out.
ENOUGH_RUNS: Final = 4
_PIECES: Final = 10
_HELD_OUT: Final = "first:0.6"

Tell = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class Request:
    """What to calibrate.

    Attributes:
        recordings: of one class of vehicles.
        given: fields of a profile, as in its YAML; what is missing is estimated. Noise and slopes with
            ``origin: calibrated`` are estimated anew.
        name: of the class where none is given.
        methods: evaluated on the runs held out.
        train_runs, run_seconds: which runs to fit to in that, see ``plan_trials``; None chooses.
    """

    recordings: Sequence[Recording]
    given: Mapping[str, Any]
    name: str
    methods: tuple[str, ...] = ("calibrated", "set_membership")
    train_runs: str | None = None
    run_seconds: float | None = None


@dataclass(frozen=True, slots=True)
class Margin:
    """A margin tried: coverage of ``set_membership`` on the runs held out, at the step where it is least, and the part
    of the tubes there whose data contradicted the bounds."""

    factor: float
    step: int
    checked: int
    inside: int
    contradicted: float

    @property
    def share(self) -> float:
        """Part of the states that lay inside."""
        return self.inside / self.checked if self.checked else 0.0

    def holds(self, confidence: float) -> bool:
        """Whether the sets hold enough states, and the data hardly ever contradicts the bounds."""
        return self.share >= confidence and self.contradicted <= 1.0 - confidence


@dataclass(frozen=True, slots=True)
class HeldOut:
    """How models and fitted bounds do on runs that they were not fitted to. Sample time, lags, measurement noise and
    limits are estimated from all runs, and the margin is chosen on these very runs."""

    train_runs: str
    run_seconds: float | None
    trained: int
    tested: int
    profile: VehicleProfile
    margins: tuple[Margin, ...]
    figures: dict[str, MethodFigures]


def evaluate_held_out(
    request: Request, recordings: Sequence[Recording], profile: VehicleProfile, fits: bool, tell: Tell
) -> HeldOut:
    """Fit to some runs, evaluate on the others."""
    train_runs, run_seconds = _split(request, recordings, profile)
    trials = plan_trials(recordings, profile, train_runs=train_runs, run_seconds=run_seconds)
    pieces = [cut(r, run_seconds) for r in recordings] if run_seconds is not None else list(recordings)
    runs = list_runs(pieces, profile)
    trained = keep(pieces, runs, choose(runs, train_runs, "--train-runs"))
    margins: list[Margin] = []
    figures: dict[str, MethodFigures] = {}
    if fits:
        tell("bounds", 0, 1)
        bounds = fitted_bounds(samples(trained, 0, 10**9), profile)
        tell("bounds", 1, 1)
        for factor in MARGINS:
            widened = _with_bounds(profile, bounds, factor)
            figures = _by_margin(trials, recordings, widened, factor, tell)
            margins.append(_worst(factor, figures["set_membership"]))
            if margins[-1].holds(profile.confidence):
                break
        profile = widened
    others = tuple(method for method in request.methods if method not in figures)
    # Without a plan the driver is part of the error of calibrated sets, here as in operation.
    driver = "recorded" if profile.future_inputs == "plan" else "learned"
    for method in others:
        inputs = driver if method == "calibrated" else "recorded"
        figures |= _evaluated(trials, recordings, profile, Settings((method,), inputs=inputs), tell)
    return HeldOut(
        train_runs, run_seconds, sum(len(r.t) for r in trained), sum(len(trial.tested) for trial in trials), profile,
        tuple(margins), {method: figures[method] for method in request.methods},
    )  # fmt: skip


def _split(request: Request, recordings: Sequence[Recording], profile: VehicleProfile) -> tuple[str, float | None]:
    """Which runs to fit to: every other one of several, else the first part of all in order of time."""
    count = len(list_runs(recordings, profile))
    if request.train_runs is not None or request.run_seconds is not None:
        return request.train_runs or "even", request.run_seconds
    if count >= ENOUGH_RUNS:
        return "even", None
    duration = sum(float(r.t[rows][-1] - r.t[rows][0]) for r in recordings for rows in r.segments())
    return _HELD_OUT, max(duration / _PIECES, 20 * profile.sample_time)


def _by_margin(
    trials: Sequence[Trial], recordings: Sequence[Recording], profile: VehicleProfile, factor: float, tell: Tell
) -> dict[str, MethodFigures]:
    def renamed(_: str, done: int, total: int) -> None:
        tell(f"margin {factor:g}", done, total)

    return _evaluated(trials, recordings, profile, Settings(("set_membership",)), renamed)


def _evaluated(
    trials: Sequence[Trial], recordings: Sequence[Recording], profile: VehicleProfile, settings: Settings, tell: Tell
) -> dict[str, MethodFigures]:
    """Figures of methods; raise ``RecordingError`` that counts what is missing where nothing could be predicted."""
    try:
        return evaluate(trials, profile, settings, tell)
    except RecordingError:
        raise RecordingError(f"{', '.join(settings.methods)}: {too_little(recordings, profile)}") from None


def _worst(factor: float, figures: MethodFigures) -> Margin:
    steps = [step for step in figures.steps if step.checked]
    if not steps:
        raise RecordingError(
            "no prediction of the held-out runs could be checked: they are too short; give longer runs, or other ones "
            "to --train-runs and --run-seconds"
        )
    worst = min(steps, key=lambda step: step.inside / step.checked)
    tubes = sum(figures.label_counts.values())
    contradicted = figures.label_counts.get("contradicted", 0) / tubes if tubes else 0.0
    return Margin(factor, worst.step, worst.checked, worst.inside, contradicted)


def _with_bounds(profile: VehicleProfile, bounds: FittedBounds, margin: float) -> VehicleProfile:
    fields = profile.model_dump(mode="json", by_alias=True, exclude_none=True)
    set_bounds(fields, bounds, margin)
    return parse_profile(fields, "the profile")


def set_bounds(fields: dict[str, Any], bounds: FittedBounds, margin: float) -> None:
    """Put fitted bounds, rounded outwards, into the fields where none are stated."""
    noise = dict(fields.get("noise") or {})
    if not stated(noise.get("process")):
        noise["process"] = box_of([round_up(float(w)) for w in bounds.widened(margin)])
    fields["noise"] = noise
    if not stated(fields.get("lipschitz")):
        # Bounds of derivatives outlast a refit of the model, slopes of its residual do not.
        lower = [[0.0 - round_up(-float(slope), 4) for slope in row] for row in bounds.lower]
        upper = [[round_up(float(slope), 4) for slope in row] for row in bounds.upper]
        fields["lipschitz"] = {"lower": lower, "upper": upper, "origin": "calibrated"}


def box_of(half: Sequence[float]) -> dict[str, Any]:
    return {"box": list(half), "origin": "calibrated"}


def stated(part: Any) -> bool:
    return isinstance(part, Mapping) and part.get("origin") == "given"
