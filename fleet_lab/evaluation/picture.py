"""The picture of an evaluation: coverage and area over the steps of the horizon, and coverage over time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fleet_bus.errors import UsageError
from fleet_bus.messages import VehicleProfile
from fleet_lab.evaluation.figures import ROLLING, MethodFigures
from reach_server.audit.prediction_check import binomial_band

#: Events that the picture marks, at most.
_MARKS: Final = 40


def draw_evaluation(
    figures: Mapping[str, MethodFigures], names: Sequence[str], profile: VehicleProfile, path: Path
) -> None:
    """Draw into ``path``; raise ``UsageError`` if the file cannot be written."""
    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "fleet-reach"
    figure = Figure(figsize=(11, 7.4), layout="constrained")
    axes: Any = figure.subplot_mosaic("AB;CC")
    _coverage(axes["A"], figures, profile)
    _area(axes["B"], figures, profile)
    _over_time(axes["C"], figures, profile)
    handles, labels = axes["A"].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(f"{', '.join(names)} · class {profile.vehicle_class}")
    save(figure, path, "--picture")


def save(figure: Figure, path: Path, option: str) -> None:
    """Write a figure; raise ``UsageError`` naming ``option`` if that fails."""
    try:
        figure.savefig(path, dpi=110, metadata={"Date": None} if path.suffix == ".svg" else None)
    except (OSError, ValueError) as error:
        raise UsageError(f"{option} {path}: cannot be drawn: {error}; choose a .png, .svg or .pdf file") from None


def _coverage(axis: Axes, figures: Mapping[str, MethodFigures], profile: VehicleProfile) -> None:
    for number, (name, method) in enumerate(figures.items()):
        steps = [step for step in method.steps if step.checked]
        at = [step.step for step in steps]
        axis.plot(at, [100 * s.inside / s.checked for s in steps], f"C{number}o-", ms=4, label=name)
        worst = [100 * (s.worst_run if s.worst_run is not None else 1.0) for s in steps]
        axis.plot(at, worst, f"C{number}v:", ms=4, lw=1, label=f"{name}, worst run")
    axis.axhline(100 * profile.confidence, color="0.4", lw=0.8, ls="--", label="confidence of the profile")
    axis.set_xlabel("step")
    axis.set_ylabel("measured states inside [%]")
    axis.set_ylim(top=100.1)
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))


def _area(axis: Axes, figures: Mapping[str, MethodFigures], profile: VehicleProfile) -> None:
    unit = profile.state[profile.state_names[profile.position[0]]].unit
    for number, method in enumerate(figures.values()):
        steps = [step for step in method.steps if step.checked]
        axis.semilogy([s.step for s in steps], [s.area_mean for s in steps], f"C{number}o:", ms=3, lw=1, alpha=0.6)
        equal = [(s.step, s.area_equal) for s in steps if s.area_equal]
        axis.semilogy([s for s, _ in equal], [area for _, area in equal], f"C{number}o-", ms=4)
    axis.set_xlabel("step")
    axis.set_ylabel(f"mean area [{unit}²]")
    axis.set_title(f"as published (dotted), scaled to {100 * profile.confidence:g} % inside (solid)", fontsize=9)
    axis.grid(which="both", alpha=0.25)
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))


def _over_time(axis: Axes, figures: Mapping[str, MethodFigures], profile: VehicleProfile) -> None:
    """Rolling coverage of the first step, trials one after the other; ticks below where an event was told."""
    begins: dict[str, int] = {}
    end = 0
    for number, method in enumerate(figures.values()):
        for trial in method.rolling:
            if trial.recording not in begins:
                begins[trial.recording] = end
                end += (trial.sample[-1] + 1) if trial.sample else 0
            at = begins[trial.recording] + np.array(trial.sample)
            axis.plot(at, 100 * np.array(trial.steps[1]), color=f"C{number}", lw=1.2)
        told = [begins[e.recording] + e.sample for e in method.events if e.recording in begins][:_MARKS]
        height = np.full(len(told), 0.03 + 0.03 * number)
        axis.plot(told, height, f"C{number}|", ms=9, transform=axis.get_xaxis_transform())
    for begin in list(begins.values())[1:]:
        axis.axvline(begin, color="0.7", lw=0.8)
    allowed = 100 * (1 - binomial_band(ROLLING, 1 - profile.confidence) / ROLLING)
    axis.axhspan(allowed, 100, color="0.93", zorder=0)
    axis.axhline(100 * profile.confidence, color="0.4", lw=0.8, ls="--")
    axis.set_ylim(top=100.1)
    axis.set_xlabel("tested sample")
    axis.set_ylabel("inside at step 1 [%]")
    title = f"over the newest {ROLLING} checks; shaded: what the confidence explains; ticks: events"
    axis.set_title(title, fontsize=9)
