"""What the command prints: progress, tables, summaries."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

from fleet_bus.messages import VehicleProfile
from fleet_lab.evaluation import MethodFigures, StepFigures
from fleet_lab.evaluation.text import evaluation_lines, number


@contextmanager
def progress() -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar per name on stderr, plain lines where that is no terminal; call what comes back with name, done
    and total."""
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"))
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _Lines()
        return
    with Progress(*columns, TimeRemainingColumn(), console=console) as bars:
        tasks: dict[str, TaskID] = {}

        def tell(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = bars.add_task(name, total=total)
            bars.update(tasks[name], completed=done, total=total)

        yield tell


class _Lines:
    """Progress as lines on stderr: a name when it begins, at each quarter, and when it is done."""

    def __init__(self) -> None:
        self._told: dict[str, int] = {}

    def __call__(self, name: str, done: int, total: int) -> None:
        quarter = 4 * done // total if total else 4
        if quarter > self._told.get(name, -1):
            self._told[name] = quarter
            print(f"{name}: {25 * quarter} %", file=sys.stderr, flush=True)


def print_evaluation(figures: Mapping[str, MethodFigures], profile: VehicleProfile, names: Sequence[str]) -> None:
    """Coverage and area by step, a line a method; areas at equal coverage are also set against the first method's."""
    unit = profile.state[profile.state_names[profile.position[0]]].unit
    first = next(iter(figures))
    share = f"{100 * profile.confidence:g} %"
    caption = f"areas in {unit}²; at {share}: mean of sets scaled so that {share} of the checked states lie inside"
    if len(figures) > 1:
        caption += f"; ratio: of that to {first}"
    title = f"{', '.join(names)} · class {profile.vehicle_class}"
    table = Table(title=title, caption=caption, box=box.SIMPLE_HEAD, padding=(0, 0, 0, 1), pad_edge=False)
    table.add_column("step", justify="right")
    table.add_column("method", no_wrap=True)
    for column in ("inside", "worst run", "mean", "median", f"at {share}", *(["ratio"] if len(figures) > 1 else [])):
        table.add_column(column, justify="right", no_wrap=True)
    for row in zip(*(method.steps for method in figures.values()), strict=True):
        for index, (name, step) in enumerate(zip(figures, row, strict=True)):
            ratio = [_ratio(step, row[0])] if len(figures) > 1 else []
            table.add_row(str(step.step) if index == 0 else "", name, *_step_cells(step), *ratio)
    console = Console()
    console.print(table)
    for line in evaluation_lines(figures):
        console.print(line, highlight=False, soft_wrap=True)


def _step_cells(step: StepFigures) -> list[str]:
    if not step.checked:
        return ["–"] * 5
    worst = "–" if step.worst_run is None else f"{100 * step.worst_run:.1f} %"
    equal = "–" if step.area_equal is None else number(step.area_equal)
    inside = f"{100 * step.inside / step.checked:.2f} %"
    return [inside, worst, number(step.area_mean), number(step.area_median), equal]


def _ratio(step: StepFigures, base: StepFigures) -> str:
    if step is base or not step.area_equal or not base.area_equal:
        return ""
    return number(step.area_equal / base.area_equal)


def _served(summary: Mapping[str, Any]) -> str:
    """What share of the samples got a tube, and why not all."""
    tubes, samples = summary["tubes"], summary["samples"]
    share = f"{100 * tubes / samples:.0f} %" if samples else "none"
    why = (
        ": the newest of a round, and played faster than real time a round takes several"
        if summary["speed"] > 1
        else ""
    )
    return f"samples that got a tube: {tubes} of {samples} ({share}){why}"


def print_summary(summary: Mapping[str, Any]) -> None:
    """The closing report of the demo."""
    console = Console()
    one = summary["one_step"]
    console.print()
    table = Table(title=f"demo {summary['scenario']}: {summary['vehicles']} vehicles, {summary['duration']:.0f} s")
    for column in ("vehicle", "samples", "tubes", "true next state inside", "label"):
        table.add_column(column, justify="left" if column in ("vehicle", "label") else "right")
    for name, vehicle in summary["by_vehicle"].items():
        held = f"{vehicle['inside']} of {vehicle['checked']}"
        held += " (strays: not counted)" if vehicle["stray"] else ""
        table.add_row(name, str(vehicle["samples"]), str(vehicle["tubes"]), held, vehicle["label"])
    console.print(table)
    lines = [
        f"one step ahead: {one['inside']} of {one['checked']} true states inside",
        f"whole horizon:  {summary['horizon']['inside']} of {summary['horizon']['checked']} true states inside",
    ]
    for step, area in summary["area"].items():
        where = "over all steps" if step == "all" else f"at step {step}"
        share = 100 * area["with"] / area["without"] if area["without"] else 100.0
        lines.append(
            f"mean area {where}: {area['with']:.4g} m² with side information, {area['without']:.4g} m² without "
            f"({share:.2f} %)"
        )
    lines.append(_served(summary))
    latency = summary["latency_ms"]
    lines.append(f"state to tube: {latency['p50']:.1f} ms median, {latency['p99']:.1f} ms 99 %")
    events = ", ".join(f"{count} {kind}" for kind, count in summary["events"].items()) or "none"
    besides = " besides those of vehicles that stray" if summary["stray"] else ""
    lines.append(f"events: {events}{besides}; messages refused: {sum(summary['refused'].values())}")
    for vehicle, stray in summary["stray"].items():
        if stray["told_at"] is not None:
            left = "did not leave" if stray["left_at"] is None else f"left at {stray['left_at']:.2f} s"
            by = f" by {stray['predicates']}" if stray["predicates"] else ""
            lines.append(
                f"{vehicle} strays: {left}, told at {stray['told_at']:.2f} s{by}, from then on "
                f"{stray['inside']} of {stray['checked']} true states inside its uncut sets"
            )
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True)
    for failure in summary["failures"]:
        console.print(f"[bold red]failed[/]: {failure}", highlight=False)
