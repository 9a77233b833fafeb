"""What a calibration found, as a page to read and as JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fleet_lab.evaluation import MethodFigures, RunFigures, as_json
from fleet_lab.evaluation.picture import draw_evaluation
from fleet_lab.evaluation.text import evaluation_lines, number
from fleet_lab.files import write_json, write_text
from fleet_lab.identification.calibrate import Calibration
from fleet_lab.identification.held_out import HeldOut
from fleet_lab.identification.picture import draw_estimates
from reach_server.audit.prediction_check import binomial_band


def as_document(calibration: Calibration, recordings: Sequence[str]) -> dict[str, Any]:
    """The document of ``fleet calibrate --json``."""
    held, found = calibration.held_out, calibration
    bounds = None
    if found.bounds is not None:
        bounds = {
            "process": found.bounds.process.tolist(),
            "lower": found.bounds.lower.tolist(),
            "upper": found.bounds.upper.tolist(),
            "transitions": found.bounds.transitions,
            "margins": [asdict(margin) for margin in held.margins],
        }
    return {
        "recordings": list(recordings),
        "profile": found.profile.model_dump(mode="json", by_alias=True, exclude_none=True),
        "choices": [asdict(choice) for choice in found.choices],
        "timing": {
            "median_s": float(np.median(found.timing.intervals)),
            "sample_time_s": found.timing.sample_time,
            "tolerance": found.timing.tolerance,
            "share_within": found.timing.share,
        },
        "measurement_noise": dict(zip(found.profile.state_names, _noise(found), strict=True)),
        "input_lags": asdict(found.lags),
        "bounds": bounds,
        "held_out": {
            "train_runs": held.train_runs,
            "run_seconds": held.run_seconds,
            "trained": held.trained,
            "tested": held.tested,
            **as_json(held.figures, recordings, held.profile, held.profile.horizon),
        },
        "warnings": list(found.warnings),
    }


def write_report(calibration: Calibration, names: Sequence[str], document: dict[str, Any], folder: Path) -> None:
    """``report.md``, ``report.json`` and two pictures in a folder; raise ``UsageError`` where that fails."""
    draw_estimates(calibration, folder / "estimates.png")
    held = calibration.held_out
    draw_evaluation(held.figures, names, held.profile, folder / "coverage.png")
    write_json(document, folder / "report.json")
    write_text("--report", folder / "report.md", as_markdown(calibration, names, ("coverage.png", "estimates.png")))


def _noise(found: Calibration) -> list[dict[str, Any]]:
    noise = found.noise
    return [
        {"deviation": deviation, "bound": bound, "from": how}
        for deviation, bound, how in zip(noise.deviation, noise.bound, noise.how, strict=True)
    ]


def as_markdown(calibration: Calibration, recordings: Sequence[str], pictures: Sequence[str]) -> str:
    """The page: what was chosen and why, how often the sets hold on runs that were held out, what to be wary of."""
    profile, held = calibration.profile, calibration.held_out
    lines = [f"# Calibration of class {profile.vehicle_class}", "", f"Recordings: {', '.join(recordings)}.", ""]
    if calibration.warnings:
        lines += ["## Be wary", "", *(f"* {warning}" for warning in calibration.warnings), ""]
    lines += ["## The profile", "", "| field | value | from | why |", "| --- | --- | --- | --- |"]
    lines += [f"| `{c.field}` | {_cell(c.value)} | {c.origin} | {c.why} |" for c in calibration.choices]
    lines += ["", "## Measurement noise", "", "| state | σ | bound | from |", "| --- | --- | --- | --- |"]
    for (name, spec), entry in zip(profile.state.items(), _noise(calibration), strict=True):
        lines.append(
            f"| {name} | {entry['deviation']:.3g} {spec.unit} | {entry['bound']:.3g} {spec.unit} | {entry['from']} |"
        )
    lines += ["", "Slow errors, as of a localisation that drifts, do not show in this estimate.", ""]
    lines += _held_out(held)
    lines += [line for name in pictures for line in (f"![]({name})", "")]
    return "\n".join(lines)


def _cell(value: Any) -> str:
    """A value in short."""
    if isinstance(value, Mapping):
        value = "; ".join(f"{name} {_cell(part)}" for name, part in value.items())
    elif isinstance(value, list | tuple):
        value = ", ".join(f"{part:g}" if isinstance(part, float) else str(part) for part in value)
    elif isinstance(value, float):
        value = f"{value:g}"
    text = str(value).replace("|", "\\|")
    return text if len(text) <= 80 else f"{text[:77]}…"


def _held_out(held: HeldOut) -> list[str]:
    cut = "" if held.run_seconds is None else f", segments cut into runs of {held.run_seconds:.3g} s"
    lines = [
        "## How often the sets hold",
        "",
        f"Fitted to the runs `{held.train_runs}` ({held.trained} samples), streamed over the others ({held.tested} "
        f"samples){cut}. Sample time, lags, measurement noise and limits were estimated from all runs, the margin on "
        "the noise was chosen on the tested ones; the profile itself is fitted to all runs.",
        "",
    ]
    if held.margins:
        tried = ", ".join(
            f"{m.factor:g}: {100 * m.share:.2f} % (step {m.step}), {100 * m.contradicted:.1f} % contradicted"
            for m in held.margins
        )
        lines += [
            f"States in `set_membership` sets at the worst step, and contradicted tubes, by margin: {tried}.",
            "",
        ]
    lines += _steps(held)
    for name, method in held.figures.items():
        lines += [f"### {name}, by run", "", *_runs(method.runs), ""]
    lines += [f"    {line}" for line in evaluation_lines(held.figures)]
    return [*lines, ""]


def _steps(held: HeldOut) -> list[str]:
    """Coverage and area by step, and whether the confidence explains the misses."""
    profile = held.profile
    unit = profile.state[profile.state_names[profile.position[0]]].unit
    lines = [
        f"| step | method | inside | worst run | mean area {unit}² | median area {unit}² | at "
        f"{100 * profile.confidence:g} % | misses |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in zip(*(method.steps for method in held.figures.values()), strict=True):
        for name, step in zip(held.figures, row, strict=True):
            if not step.checked:
                continue
            band = binomial_band(step.checked, 1 - profile.confidence)
            missed = step.checked - step.inside
            verdict = f"{missed} of {step.checked}, explained: up to {band}"
            worst = "–" if step.worst_run is None else f"{100 * step.worst_run:.1f} %"
            equal = "–" if step.area_equal is None else number(step.area_equal)
            cells = (
                str(step.step),
                name,
                _share(step.inside, step.checked),
                worst,
                number(step.area_mean),
                number(step.area_median),
                equal,
                verdict,
            )
            lines.append(f"| {' | '.join(cells)} |")
    explained = (
        f"*Explained* is how many misses a confidence of {100 * profile.confidence:g} % leads to in 99 of 100 cases, "
        "if they come one by one. They come in groups (neighbouring predictions miss together): more are no proof."
    )
    return [*lines, "", explained, ""]


def _runs(runs: Sequence[RunFigures]) -> list[str]:
    steps = len(runs[0].checked)
    shown = sorted({1, (steps + 1) // 2, steps})
    head = " | ".join(f"step {step}" for step in shown)
    lines = [f"| run | {head} |", f"| --- |{' --- |' * len(shown)}"]
    for run in runs:
        cells = [
            f"{_share(run.inside[h - 1], run.checked[h - 1])} of {run.checked[h - 1]}" if run.checked[h - 1] else "–"
            for h in shown
        ]
        lines.append(f"| {run.name} | {' | '.join(cells)} |")
    return lines


def _share(inside: int, checked: int) -> str:
    return f"{100 * inside / checked:.2f} %" if checked else "–"


def summary(calibration: Calibration) -> list[str]:
    """The lines printed when a calibration is done."""
    held = calibration.held_out
    lines = [f"{c.field}: {_cell(c.value)} ({c.origin}: {c.why})" for c in calibration.choices if c.origin != "given"]
    for name, method in held.figures.items():
        lines.append(f"held out, {name}: {_in_short(method)}")
    return [*lines, *(f"be wary: {warning}" for warning in calibration.warnings)]


def _in_short(method: MethodFigures) -> str:
    steps = method.steps
    parts = []
    for step in (steps[h - 1] for h in sorted({1, (len(steps) + 1) // 2, len(steps)})):
        worst = "" if step.worst_run is None else f" (worst run {100 * step.worst_run:.1f} %)"
        parts.append(f"step {step.step} {_share(step.inside, step.checked)}{worst}")
    return ", ".join(parts)
