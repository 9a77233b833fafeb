"""The picture of the estimates of a calibration: sample intervals, delay of the inputs, coverage by run."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fleet_lab.evaluation.picture import save
from fleet_lab.identification.calibrate import Calibration


def draw_estimates(calibration: Calibration, path: Path) -> None:
    """Draw into ``path``; raise ``UsageError`` if the file cannot be written."""
    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "fleet-reach"
    figure = Figure(figsize=(12, 3.8), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    _intervals(left, calibration)
    _lags(middle, calibration)
    _runs(right, calibration)
    save(figure, path, "--report")


def _intervals(axis: Axes, calibration: Calibration) -> None:
    found = calibration.timing
    milliseconds = 1e3 * found.intervals
    low, high = 1e3 * found.sample_time * (1 + found.tolerance * np.array([-1, 1]))
    reach = max(high, float(np.percentile(milliseconds, 99.5))) * 1.1
    axis.hist(np.minimum(milliseconds, reach), bins=60, range=(0, reach), color="C0")
    axis.axvspan(low, high, color="0.9", zorder=0, label=f"within tolerance: {100 * found.share:.1f} %")
    label = f"sample time {1e3 * found.sample_time:g} ms"
    axis.axvline(1e3 * found.sample_time, color="0.3", lw=0.8, ls="--", label=label)
    axis.set_yscale("log")
    axis.set_ylim(bottom=0.7)
    axis.set_xlabel("sample interval [ms]")
    axis.set_ylabel("count")
    axis.legend(fontsize=8, frameon=False)


def _lags(axis: Axes, calibration: Calibration) -> None:
    found, profile = calibration.lags, calibration.profile
    axis.set_xlabel("age of the oldest input used [ms]")
    axis.set_ylabel("cross-validated error, least = 1")
    if not found.tried:
        axis.text(0.5, 0.5, "too few samples to tell", ha="center", transform=axis.transAxes, color="0.4")
        return
    for name, error in found.error.items():
        axis.plot(
            1e3 * profile.sample_time * np.array(found.tried), np.array(error) / min(error), "o-", ms=3, label=name
        )
    chosen = 1e3 * profile.sample_time * profile.input_lags
    axis.axvline(chosen, color="0.3", lw=0.8, ls="--", label=f"input_lags {profile.input_lags}")
    axis.legend(fontsize=8, frameon=False)


def _runs(axis: Axes, calibration: Calibration) -> None:
    """Coverage of the first and last step by run held out."""
    held = calibration.held_out
    for number, (name, method) in enumerate(held.figures.items()):
        for step, mark in ((0, "o"), (-1, "v")):
            share = [100 * r.inside[step] / r.checked[step] if r.checked[step] else np.nan for r in method.runs]
            label = f"{name}, step {method.steps[step].step}"
            axis.plot(np.arange(len(share)), share, f"C{number}{mark}", ms=5, alpha=0.6, label=label)
    axis.axhline(100 * held.profile.confidence, color="0.4", lw=0.8, ls="--")
    axis.set_ylim(top=100.5)
    axis.set_xlabel("run held out")
    axis.set_ylabel("measured states inside [%]")
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.legend(fontsize=8, ncols=2, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0))
