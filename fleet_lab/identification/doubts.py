"""What to be wary of in the figures of the runs held out, and what to say where too little could be predicted."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import VehicleProfile
from fleet_lab.evaluation import MethodFigures, StepFigures
from reach_server.audit.prediction_check import binomial_band
from reach_server.data.regressors import RegressorSpec
from reach_server.models.conformal.spec import FeatureSpec
from vehicle_agent.recording import Recording

#: Mean area over the median from which a few sets make the mean.
ORDERS: Final = 10.0


def of_figures(figures: Mapping[str, MethodFigures], confidence: float, unit: str) -> list[str]:
    """Methods whose sets held fewer states than the confidence at a step or in a run, and areas whose mean is orders
    above their median."""
    found = []
    for name, method in figures.items():
        for text in (_rates(method, confidence), areas_apart(method.steps, unit)):
            if text:
                found.append(f"{name}: {text}")
    return found


def _rates(method: MethodFigures, confidence: float) -> str:
    """Steps and runs with fewer states inside than stated, the worst of each, and whether chance explains them."""
    checked = [step for step in method.steps if step.checked]
    low = [step for step in checked if step.inside < confidence * step.checked]
    runs = [
        (inside / checks, run.name, h + 1)
        for run in method.runs
        for h, (checks, inside) in enumerate(zip(run.checked, run.inside, strict=True))
        if checks and inside < confidence * checks
    ]
    parts = []
    if low:
        worst = min(low, key=lambda step: step.inside / step.checked)
        clear = sum(s.checked - s.inside > binomial_band(s.checked, 1 - confidence) for s in low)
        explained = f"{len(low) - clear} of these" if clear else "all"
        by_chance = f"; chance explains {explained}, if misses came one by one"
        parts.append(
            f"{_percent(worst.inside / worst.checked)} of the states lie inside at step {worst.step}, below the "
            f"{100 * confidence:g} % stated ({len(low)} of {len(checked)} steps are below{by_chance})"
        )
    if runs:
        share, name, step = min(runs)
        count = len({run for _, run, _ in runs})
        parts.append(
            f"the worst run is {name}, {_percent(share)} at step {step} ({count} of {len(method.runs)} runs are below "
            f"{100 * confidence:g} % at some step)"
        )
    if not parts:
        return ""
    todo = (
        "count on these rates, not on the one stated: give more recordings of such driving, state a confidence nearer "
        "to 1 or a longer window, and see that no role is missing"
    )
    return "; ".join((*parts, todo))


def areas_apart(steps: Sequence[StepFigures], unit: str) -> str:
    """Where the mean area is ``ORDERS`` or more times the median, in words; empty where it is nowhere."""
    apart = [s for s in steps if s.checked and s.area_mean >= ORDERS * s.area_median and s.area_mean > 0]
    if not apart:
        return ""
    worst = max(apart, key=lambda s: s.area_mean / s.area_median if s.area_median > 0 else np.inf)
    times = f"{worst.area_mean / worst.area_median:.2g} times" if worst.area_median > 0 else "far above"
    return (
        f"the mean area at step {worst.step} is {worst.area_mean:.3g} {unit}², {times} the median of "
        f"{worst.area_median:.3g} {unit}² (at {len(apart)} of {len(steps)} steps they differ by orders): a few sets "
        "are far larger than the others, as where a vehicle does what the window has not seen; look at both"
    )


def too_little(recordings: Sequence[Recording], profile: VehicleProfile) -> str:
    """Why no sample of recordings (columns as in the profile) could be predicted, with counts, and what to do."""
    layout = RegressorSpec.of(profile)
    spec = FeatureSpec.of(profile, layout, profile.horizon, planned=profile.future_inputs == "plan")
    total = off = steps = able = data = 0
    for recording in recordings:
        known = np.asarray(np.isfinite(recording.u).all(axis=1))
        for rows in recording.segments():
            off_by = np.abs(np.diff(recording.t[rows]) / profile.sample_time - 1)
            regular = np.asarray(off_by <= profile.tolerance)
            total, off, steps = total + rows.stop - rows.start, off + int((~regular).sum()), steps + len(regular)
            row = _in_a_row(np.asarray(regular & known[rows.start + 1 : rows.stop]))
            able += int((row >= spec.reach).sum())
            data += int((row >= spec.reach + profile.horizon).sum())
    needed = spec.reach + profile.horizon
    counts = (
        f"of {total} samples {able} have the {spec.reach} regular intervals with known inputs in a row before them "
        f"that a prediction rests on, and {data} the {needed} that make a datum of the model with input_lags "
        f"{profile.input_lags} and horizon {profile.horizon}"
    )
    if off > 0.01 * steps:
        return (
            f"the sample intervals are too irregular: {off} of {steps} are more than {100 * profile.tolerance:g} % off "
            f"{1e3 * profile.sample_time:g} ms, and {counts}; bring the recording to even intervals (states "
            "interpolated, inputs held) or record at a fixed rate; fewer input_lags or a shorter horizon in the "
            "profile need fewer in a row"
        )
    return (
        f"too few samples to predict any that is held out: {counts}; give more recordings, or state fewer input_lags, "
        "a shorter horizon or window, or a smaller confidence in the profile"
    )


def _in_a_row(good: NDArray[np.bool_]) -> NDArray[np.intp]:
    """How many intervals before each sample (T,) are good without a break, for intervals (T - 1,)."""
    index = np.arange(len(good) + 1)
    broken = np.where(np.concatenate([[True], ~good]), index, 0)
    return index - np.maximum.accumulate(broken)


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"
