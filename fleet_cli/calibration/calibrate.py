"""The steps of a calibration."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from fleet_bus.errors import ProfileError, RecordingError
from fleet_bus.messages import VehicleProfile, parse_profile
from fleet_bus.units import seconds
from fleet_cli.calibration.bounds import FittedBounds, fitted_bounds
from fleet_cli.calibration.draft import Choice, complete, observed_limits, round_up
from fleet_cli.calibration.estimates import (
    TOLERATED,
    Lags,
    NoiseEstimate,
    Timing,
    input_lags,
    measurement_noise,
    timing,
)
from fleet_cli.evaluation import MethodFigures, Settings, Trial, evaluate, plan_trials
from fleet_cli.evaluation.runs import choose, cut, keep, list_runs
from fleet_cli.evaluation.trials import samples
from reach_server.calibrated.learner import least_window
from reach_server.engine import Engine
from reach_server.regression import Layout
from vehicle_agent.recording import Recording

#: Factors by which all noise is widened until enough held-out states lie inside, at every step of the horizon.
MARGINS: Final = (1.0, 1.25, 1.5, 2.0, 3.0)
#: Runs from which on every other one is held out; fewer are cut, and the last ones held out.
ENOUGH_RUNS: Final = 4
_PIECES: Final = 10
_HELD_OUT: Final = "first:0.6"
#: Samples below which nothing is estimated.
LEAST_SAMPLES: Final = 200

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


@dataclass(frozen=True, slots=True)
class Calibration:
    """The profile, where each field comes from, the estimates behind, how it does, and what to be wary of."""

    profile: VehicleProfile
    choices: tuple[Choice, ...]
    timing: Timing
    noise: NoiseEstimate
    lags: Lags
    bounds: FittedBounds | None
    held_out: HeldOut
    warnings: tuple[str, ...]


@dataclass(slots=True)
class _Draft:
    """Fields of the profile so far and where they come from."""

    fields: dict[str, Any]
    choices: list[Choice]
    warnings: list[str] = field(default_factory=list)

    def estimate(self, name: str, value: Any, why: str) -> None:
        """Set a field that is not given."""
        self.fields[name] = value
        self.choices.append(Choice(name, value, "estimated", why))

    def profile(self) -> VehicleProfile:
        """The profile as it stands; raises ``ProfileError``."""
        return parse_profile(self.fields, "the profile")


def calibrate(request: Request, tell: Tell) -> Calibration:
    """The profile of some recordings; ``tell`` is called with what is being done, and how far it is.

    Raises ``ProfileError`` for given fields that cannot be, ``RecordingError`` for recordings that do not have what
    is asked for or are too short.
    """
    given = {name: value for name, value in request.given.items() if name != "lipschitz" or _stated(value)}
    fields, choices = complete(_without_fitted_noise(given), list(request.recordings), request.name)
    draft = _Draft(fields, choices)
    _need_samples(request.recordings)
    found = _timing(draft, request.recordings, tell)
    profile = draft.profile()
    recordings = [recording.select(profile) for recording in request.recordings]
    noise = _noise(draft, recordings, profile, tell)
    lags = _lags(draft, recordings, draft.profile(), tell)
    _limits(draft, recordings)
    _window(draft, recordings)
    for method in request.methods:
        # An unknown method is told before the work.
        Engine(draft.profile(), method=method)
    fits = draft.profile().lipschitz is None or "process" not in draft.fields.get("noise", {})
    held_out = _held_out(request, recordings, draft.profile(), fits, tell)
    margin = held_out.margins[-1].factor if held_out.margins else 1.0
    bounds = None
    if fits:
        tell("bounds over all runs", 0, 1)
        bounds = fitted_bounds(samples(recordings, 0, 10**9), draft.profile())
        _keep_bounds(draft, bounds, margin, held_out)
        tell("bounds over all runs", 1, 1)
    return Calibration(
        draft.profile(), tuple(_with_given(request.given, draft)), found, noise, lags, bounds, held_out,
        tuple(draft.warnings),
    )  # fmt: skip


def _stated(part: Any) -> bool:
    return isinstance(part, Mapping) and part.get("origin") == "given"


def _without_fitted_noise(given: Mapping[str, Any]) -> dict[str, Any]:
    """The fields without noise sets that an earlier calibration has fitted."""
    fields = dict(given)
    if isinstance(noise := fields.get("noise"), Mapping):
        fields["noise"] = {kind: part for kind, part in noise.items() if _stated(part)}
    return fields


def _with_given(given: Mapping[str, Any], draft: _Draft) -> list[Choice]:
    """All choices, those of the given profile first."""
    chosen = {choice.field.split(".")[0] for choice in draft.choices}
    kept = [Choice(name, draft.fields[name], "given", "as in the profile") for name in given if name in draft.fields]
    return [*(choice for choice in kept if choice.field not in chosen), *draft.choices]


def _need_samples(recordings: Sequence[Recording]) -> None:
    total = sum(len(recording.t) for recording in recordings)
    if total < LEAST_SAMPLES:
        raise RecordingError(
            f"{total} samples in {len(recordings)} recording(s): at least {LEAST_SAMPLES} are needed, "
            "1000 or more are better: give more recordings"
        )


def _timing(draft: _Draft, recordings: Sequence[Recording], tell: Tell) -> Timing:
    tell("timing", 0, 1)
    try:
        sample_time = seconds(draft.fields["sample_time"]) if "sample_time" in draft.fields else None
    except ValueError as error:
        raise ProfileError(f"the profile: sample_time: {error}") from None
    stated = draft.fields.get("tolerance")
    tolerance = float(stated) if isinstance(stated, int | float) else None
    found = timing(recordings, sample_time, tolerance)
    median = 1e3 * float(np.median(found.intervals))
    if found.share < 0.2:
        raise RecordingError(
            f"only {100 * found.share:.0f} % of the sample intervals are within {100 * found.tolerance:g} % of "
            f"{1e3 * found.sample_time:g} ms, their median is {median:.4g} ms: correct sample_time or leave it out"
        )
    if found.share < TOLERATED:
        draft.warnings.append(
            f"{100 * (1 - found.share):.1f} % of the sample intervals are more than {100 * found.tolerance:g} % off "
            "the sample time: each ends a trajectory"
        )
    if "sample_time" not in draft.fields:
        draft.estimate("sample_time", found.sample_time, f"median interval {median:.4g} ms")
    if "tolerance" not in draft.fields:
        draft.estimate("tolerance", found.tolerance, f"holds {100 * found.share:.1f} % of the intervals")
    tell("timing", 1, 1)
    return found


def _noise(draft: _Draft, recordings: Sequence[Recording], profile: VehicleProfile, tell: Tell) -> NoiseEstimate:
    tell("measurement noise", 0, 1)
    found = measurement_noise(recordings, profile)
    if profile.noise.measurement is None:
        box = [round_up(bound) for bound in found.bound]
        draft.fields["noise"] = {**draft.fields.get("noise", {}), "measurement": _box(box)}
        rate = 1 / profile.sample_time
        why = f"4 σ of third differences at {rate:.3g} Hz{', too large where motion leaks' if rate < 50 else ''}"
        draft.choices.append(Choice("noise.measurement", box, "estimated", why))
    tell("measurement noise", 1, 1)
    return found


def _lags(draft: _Draft, recordings: Sequence[Recording], profile: VehicleProfile, tell: Tell) -> Lags:
    tell("delay of the inputs", 0, 1)
    found = input_lags(recordings, profile)
    if "input_lags" not in draft.fields:
        delay = 1e3 * found.chosen * profile.sample_time
        draft.estimate("input_lags", found.chosen, f"inputs up to {delay:.3g} ms old explain what the vehicle does")
    tell("delay of the inputs", 1, 1)
    return found


def _limits(draft: _Draft, recordings: Sequence[Recording]) -> None:
    """The observed range as limits of inputs that have none: the guaranteed methods need some."""
    inputs = dict(draft.fields.get("inputs", {}))
    for name, limits in observed_limits(list(recordings), inputs).items():
        spec = inputs[name]
        inputs[name] = {**(spec if isinstance(spec, Mapping) else {"unit": spec}), "limits": list(limits)}
        draft.choices.append(
            Choice(f"inputs.{name}.limits", list(limits), "estimated", "range observed; correct it if it can be left")
        )
    draft.fields["inputs"] = inputs


def _window(draft: _Draft, recordings: Sequence[Recording]) -> None:
    """A window that the training part of the recordings can fill, but one that resolves the confidence."""
    total = sum(len(recording.t) for recording in recordings)
    if "window" not in draft.fields and total < 2 * VehicleProfile.model_fields["window"].default:
        least = least_window(draft.profile().confidence)
        draft.estimate("window", max(total // 2, least), f"half of the {total} samples, {least} at least")


def _box(half: Sequence[float]) -> dict[str, Any]:
    return {"box": list(half), "origin": "calibrated"}


def _held_out(
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
            figures = _by_margin(trials, widened, factor, tell)
            margins.append(_worst(factor, figures["set_membership"]))
            if margins[-1].holds(profile.confidence):
                break
        profile = widened
    others = tuple(method for method in request.methods if method not in figures)
    # Without a plan the driver is part of the error of calibrated sets, here as in operation.
    driver = "recorded" if profile.future_inputs == "plan" else "learned"
    for method in others:
        inputs = driver if method == "calibrated" else "recorded"
        figures |= evaluate(trials, profile, Settings((method,), inputs=inputs), tell)
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


def _by_margin(trials: Sequence[Trial], profile: VehicleProfile, factor: float, tell: Tell) -> dict[str, MethodFigures]:
    def renamed(_: str, done: int, total: int) -> None:
        tell(f"margin {factor:g}", done, total)

    return evaluate(trials, profile, Settings(("set_membership",)), renamed)


def _worst(factor: float, figures: MethodFigures) -> Margin:
    steps = [step for step in figures.steps if step.checked]
    if not steps:
        raise RecordingError("no prediction of the held-out runs could be checked: they are too short")
    worst = min(steps, key=lambda step: step.inside / step.checked)
    tubes = sum(figures.label_counts.values())
    contradicted = figures.label_counts.get("contradicted", 0) / tubes if tubes else 0.0
    return Margin(factor, worst.step, worst.checked, worst.inside, contradicted)


def _with_bounds(profile: VehicleProfile, bounds: FittedBounds, margin: float) -> VehicleProfile:
    fields = profile.model_dump(mode="json", by_alias=True, exclude_none=True)
    _set_bounds(fields, bounds, margin)
    return parse_profile(fields, "the profile")


def _set_bounds(fields: dict[str, Any], bounds: FittedBounds, margin: float) -> None:
    """Put fitted bounds, rounded outwards, into the fields where none are stated."""
    noise = dict(fields.get("noise") or {})
    if not _stated(noise.get("process")):
        noise["process"] = _box([round_up(float(w)) for w in bounds.widened(margin)])
    fields["noise"] = noise
    if not _stated(fields.get("lipschitz")):
        # Bounds of derivatives outlast a refit of the model, slopes of its residual do not.
        lower = [[0.0 - round_up(-float(slope), 4) for slope in row] for row in bounds.lower]
        upper = [[round_up(float(slope), 4) for slope in row] for row in bounds.upper]
        fields["lipschitz"] = {"lower": lower, "upper": upper, "origin": "calibrated"}


def _keep_bounds(draft: _Draft, bounds: FittedBounds, margin: float, held_out: HeldOut) -> None:
    _set_bounds(draft.fields, bounds, margin)
    tried = held_out.margins[-1]
    if not tried.holds(held_out.profile.confidence):
        draft.warnings.append(
            f"with the greatest margin tried ({margin:g}) {100 * tried.share:.1f} % of the held-out states lie in the "
            f"set_membership sets of step {tried.step}, and {100 * tried.contradicted:.1f} % of the tubes are "
            "contradicted: the fitted bounds do not hold, use calibrated"
        )
    why = f"linear program over {bounds.transitions} transitions"
    process = draft.fields["noise"]["process"].get("box")
    draft.choices.append(Choice("noise.process", process, "estimated", f"{why}, all noise times {margin:g}"))
    layout = Layout.of(draft.profile())
    size = f"derivatives of {layout.n} states by {layout.regressors} regressors"
    draft.choices.append(Choice("lipschitz", size, "estimated", why))
