"""What the command prints: progress, tables, summaries."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

from fleet_bus.messages import VehicleProfile
from fleet_cli.evaluation import MethodFigures


@contextmanager
def progress() -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar per name on stderr; call what comes back with name, done and total."""
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"))
    console = Console(stderr=True)
    with Progress(*columns, TimeRemainingColumn(), console=console, disable=not console.is_terminal) as bars:
        tasks: dict[str, TaskID] = {}

        def tell(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = bars.add_task(name, total=total)
            bars.update(tasks[name], completed=done, total=total)

        yield tell


def print_evaluation(figures: Mapping[str, MethodFigures], profile: VehicleProfile, names: Sequence[str]) -> None:
    """Coverage and area by step, the methods side by side."""
    unit = next(iter(profile.state.values())).unit
    table = Table(title=f"{', '.join(names)} · class {profile.vehicle_class}")
    table.add_column("step", justify="right")
    for name in figures:
        table.add_column(f"{name}\ninside", justify="right")
        table.add_column(f"\narea mean {unit}²", justify="right")
        table.add_column(f"\nmedian {unit}²", justify="right")
    steps = zip(*(method.steps for method in figures.values()), strict=True)
    for row in steps:
        cells = [str(row[0].step)]
        for figure in row:
            share = f"{100 * figure.inside / figure.checked:.2f} % of {figure.checked}" if figure.checked else "–"
            cells += [share, f"{figure.area_mean:.4g}", f"{figure.area_median:.4g}"]
        table.add_row(*cells)
    console = Console()
    console.print(table)
    for name, method in figures.items():
        labels = ", ".join(f"{count} {label}" for label, count in sorted(method.label_counts.items()))
        console.print(f"{name}: {method.update_us_median:.0f} µs an update (median), labels: {labels}", highlight=False)


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
