"""What an evaluation found, in lines of text."""

import math
from collections import Counter
from collections.abc import Mapping
from typing import Any, Final

from fleet_lab.evaluation.figures import ROLLING, MethodFigures

#: Mean and median of areas that differ by more than this factor are told of.
APART: Final = 10.0


def evaluation_lines(figures: Mapping[str, MethodFigures]) -> list[str]:
    """Times, labels, worst runs, rolling coverage and events of each method."""
    lines = []
    for name, method in figures.items():
        labels = ", ".join(f"{count} {label}" for label, count in sorted(method.label_counts.items()))
        lines.append(
            f"{name}: {method.update_us_median:.0f} µs an update (median; 99 %: {method.update_us_p99:.0f}), "
            f"labels: {labels}"
        )
        ends = dict.fromkeys((method.steps[0], method.steps[-1]))
        lines.append("  checked: " + ", ".join(f"{step.checked} at step {step.step}" for step in ends))
        worst = [step for step in method.steps if step.worst_run is not None and step.worst_run < 1]
        if worst:
            step = min(worst, key=lambda s: s.worst_run or 0.0)
            share = 100 * (step.worst_run or 0.0)
            lines.append(f"  worst run of all steps: {step.worst_run_name}, {share:.1f} % at step {step.step}")
        lines += _areas(method)
        lines += _over_time(method)
        if method.waiting:
            reasons = ", ".join(f"{count} {reason}" for reason, count in method.waiting.items())
            lines.append(f"  samples without a tube: {reasons}")
        if method.events:
            first: dict[str, Any] = {}
            for event in method.events:
                first.setdefault(event.kind, event)
            counts = Counter(event.kind for event in method.events)
            told = ", ".join(f"{n} {kind} (first after {first[kind].sample} samples)" for kind, n in counts.items())
            lines.append(f"  events: {told}")
    return lines


def _areas(method: MethodFigures) -> list[str]:
    """Mean and median of the area at the first and the last step, and where they differ by orders of magnitude: then a
    few sets are what the mean is made of."""
    checked = [step for step in method.steps if step.checked]
    if not checked:
        return []
    ends = dict.fromkeys((checked[0], checked[-1]))
    told = "; ".join(f"{number(s.area_mean)} and {number(s.area_median)} at step {s.step}" for s in ends)
    lines = [f"  area, mean and median: {told}"]
    apart = [step for step in checked if step.area_mean > APART * step.area_median]
    if apart:
        step = max(apart, key=lambda s: s.area_mean / s.area_median if s.area_median else math.inf)
        times = number(step.area_mean / step.area_median) if step.area_median else "infinitely many"
        lines.append(
            f"  areas differ by orders of magnitude: at step {step.step} the mean is {times} times the median (more "
            f"than {APART:g} times at {len(apart)} of {len(checked)} steps), so a few sets are far larger than the "
            "others; the notes of their tubes say why"
        )
    return lines


def _over_time(method: MethodFigures) -> list[str]:
    """Where the coverage over the newest checks was lowest, and where it ended, for one trial."""
    lines = []
    for trial in method.rolling:
        full = [i for i, at in enumerate(trial.sample) if at - trial.sample[0] >= ROLLING]
        if not full or len(method.rolling) > 1:
            continue
        parts = []
        for step, shares in trial.steps.items():
            low = min(full, key=lambda i: shares[i])
            parts.append(
                f"step {step}: lowest {100 * shares[low]:.1f} % after {trial.sample[low]} samples, "
                f"last {100 * shares[-1]:.1f} %"
            )
        lines.append(f"  over the newest {ROLLING} checks: {'; '.join(parts)}")
    return lines


def number(value: float) -> str:
    """Three significant digits, without an exponent where that is short."""
    text = f"{value:.3g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < 1e6 else text
