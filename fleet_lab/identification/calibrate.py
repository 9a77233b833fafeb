"""The steps of a calibration."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from fleet_bus.errors import ProfileError, RecordingError, UsageError
from fleet_bus.messages import VehicleProfile, parse_profile
from fleet_bus.messages.methods import METHODS
from fleet_bus.units import seconds
from fleet_lab.evaluation.trials import samples
from fleet_lab.identification import doubts
from fleet_lab.identification.bounds import FittedBounds, fitted_bounds
from fleet_lab.identification.draft import Choice, complete, observed_limits, round_up
from fleet_lab.identification.estimates import (
    TOLERATED,
    Lags,
    NoiseEstimate,
    Timing,
    input_lags,
    measurement_noise,
    timing,
)
from fleet_lab.identification.held_out import HeldOut, Request, Tell, box_of, evaluate_held_out, set_bounds, stated
from fleet_lab.identification.sense import examine
from reach_server.data.regressors import RegressorSpec
from reach_server.engine.engine import Engine
from reach_server.models.conformal.predictor import least_window
from vehicle_agent.recording import Recording

#: Samples below which nothing is estimated.
LEAST_SAMPLES: Final = 200


class CalibrationError(RecordingError):
    """Recordings that no calibration can be made of. ``fields`` are those of the profile as far as it came, and
    ``choices`` where they come from: something to edit, and to begin again with."""

    def __init__(self, message: str, fields: Mapping[str, Any], choices: Sequence[Choice]) -> None:
        super().__init__(message)
        self.fields = dict(fields)
        self.choices = tuple(choices)


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

    Raises ``ProfileError`` for given fields that cannot be, ``UsageError`` for wrong use, ``CalibrationError`` for
    recordings that do not have what is asked for, contradict themselves or are too short; it has what was found so far.
    """
    for method in request.methods:
        if method not in ("default", *METHODS):
            raise UsageError(f"method {method!r} is unknown: choose one of default, {', '.join(METHODS)}")
    given = {name: value for name, value in request.given.items() if name != "lipschitz" or stated(value)}
    fields, choices = complete(_without_fitted_noise(given), list(request.recordings), request.name)
    draft = _Draft(fields, choices)
    try:
        return _calibrated(request, draft, tell)
    except RecordingError as error:
        raise CalibrationError(str(error), draft.fields, _with_given(request.given, draft)) from None


def _calibrated(request: Request, draft: _Draft, tell: Tell) -> Calibration:
    _examine(draft, request)
    found = _timing(draft, request.recordings, tell)
    _need_samples(request.recordings)
    profile = draft.profile()
    recordings = [recording.select(profile) for recording in request.recordings]
    noise = _noise(draft, recordings, profile, tell)
    lags = _lags(draft, recordings, draft.profile(), tell)
    _limits(draft, recordings)
    _window(draft, recordings)
    for method in request.methods:
        # What a method cannot work with is told before the work.
        try:
            Engine(draft.profile(), method=method)
        except UsageError as error:
            raise RecordingError(str(error)) from None
    fits = draft.profile().lipschitz is None or "process" not in draft.fields.get("noise", {})
    held_out = evaluate_held_out(request, recordings, draft.profile(), fits, tell)
    margin = held_out.margins[-1].factor if held_out.margins else 1.0
    bounds = None
    if fits:
        tell("bounds over all runs", 0, 1)
        bounds = fitted_bounds(samples(recordings, 0, 10**9), draft.profile())
        _keep_bounds(draft, bounds, margin, held_out)
        tell("bounds over all runs", 1, 1)
    profile = draft.profile()
    unit = profile.state[profile.state_names[profile.position[0]]].unit
    draft.warnings += doubts.of_figures(held_out.figures, held_out.profile.confidence, unit)
    return Calibration(
        profile, tuple(_with_given(request.given, draft)), found, noise, lags, bounds, held_out, tuple(draft.warnings)
    )


def _examine(draft: _Draft, request: Request) -> None:
    """Refuse recordings that contradict themselves, with all that is wrong at once; note what is doubtful."""
    found = examine(request.recordings, draft.fields, guessed="roles" not in request.given)
    draft.warnings += found.doubts
    if not found.problems:
        return
    if found.sample_time is not None and "sample_time" not in draft.fields:
        draft.estimate("sample_time", _rounded(found.sample_time), "median interval, the stamps taken for another unit")
    names = ", ".join(recording.name for recording in request.recordings)
    raise RecordingError(f"{names}: {'; and '.join(found.problems)}")


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _without_fitted_noise(given: Mapping[str, Any]) -> dict[str, Any]:
    """The fields without noise sets that an earlier calibration has fitted."""
    fields = dict(given)
    if isinstance(noise := fields.get("noise"), Mapping):
        fields["noise"] = {kind: part for kind, part in noise.items() if stated(part)}
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
            "the sample time: each ends a trajectory; record at a fixed rate, or state a tolerance or sample_time that "
            "holds them"
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
        draft.fields["noise"] = {**draft.fields.get("noise", {}), "measurement": box_of(box)}
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


def _keep_bounds(draft: _Draft, bounds: FittedBounds, margin: float, held_out: HeldOut) -> None:
    set_bounds(draft.fields, bounds, margin)
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
    layout = RegressorSpec.of(draft.profile())
    size = f"derivatives of {layout.n} states by {layout.regressors} regressors"
    draft.choices.append(Choice("lipschitz", size, "estimated", why))
