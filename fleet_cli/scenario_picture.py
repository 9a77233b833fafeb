"""The picture of a scenario: its regions in the plane, and beneath it when each predicate is asked for."""

import textwrap
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fleet_bus.errors import UsageError
from fleet_cli.scenario_activity import Activity, spans
from fleet_cli.scenario_files import describe
from fleet_cli.scenario_plane import Drawn, Plane, lay_out
from side_info.documents.scenario import Scenario

#: Predicates shown over time.
MOST_ROWS: Final = 40

_HATCHES: Final = ("", "//", "\\\\", "..", "xx")
_NAME_LENGTH: Final = 44
_ROW_HEIGHT: Final = 0.24
_BAR: Final = 0.64
_IN_ANY_CASE: Final = "#08519c"
_IN_SOME_CASE: Final = "#9ecae1"


def draw_scenario(scenario: Scenario, activity: Activity, path: Path) -> None:
    """Draw into ``path``; raise ``UsageError`` if the file cannot be written."""
    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "fleet-reach"
    plane, drawn, left_out = lay_out(scenario)
    rows = [p for p in range(len(scenario.predicates)) if activity.some[:, p].any()]
    shown = rows[:MOST_ROWS]
    notes = [f"{name} is not drawn: {reason}." for name, reason in left_out.items()]
    if len(shown) < len(rows):
        notes.append(f"{len(rows) - len(shown)} more predicates are asked for.")
    if activity.cut_short:
        notes.append(f"The first {len(activity.some)} samples are shown.")
    heights = [5.2 if drawn else 0.8, max(_ROW_HEIGHT * len(shown), 0.6) + 0.5]
    figure = Figure(figsize=(9.5, sum(heights) + 1.3 + 0.2 * len(notes)), layout="constrained")
    top, bottom = figure.subplots(2, 1, height_ratios=heights)
    if plane is None or not drawn:
        top.axis("off")
        top.text(0.5, 0.5, "no region lies in a plane of two states", ha="center", va="center", color="0.4")
    else:
        _draw_regions(top, plane, drawn, scenario)
    _draw_activity(bottom, scenario, activity, shown)
    title = "\n".join(textwrap.wrap(describe(scenario), 120))
    figure.suptitle(f"{scenario.name} v{scenario.version}\n{title}", fontsize=10)
    if notes:
        text = "\n".join(line for note in notes for line in textwrap.wrap(note, 130))
        figure.supxlabel(text, fontsize=8, color="0.35", x=0.01, ha="left")
    try:
        figure.savefig(path, dpi=110, metadata={"Date": None} if path.suffix == ".svg" else None)
    except (OSError, ValueError) as error:
        raise UsageError(f"-o {path}: cannot be drawn: {error}; choose a .png, .svg or .pdf file") from None


def _draw_regions(axis: Axes, plane: Plane, drawn: tuple[Drawn, ...], scenario: Scenario) -> None:
    handles = []
    for number, region in enumerate(drawn):
        color, hatch = f"C{number % 10}", _HATCHES[number // 10 % len(_HATCHES)]
        levels = [0.0, np.inf]
        axis.contourf(plane.x, plane.y, region.margin, levels, colors=[color], alpha=0.18, hatches=[hatch])
        axis.contour(plane.x, plane.y, region.margin, [0.0], colors=[color], linewidths=1.4)
        empty = " (nowhere here)" if (region.margin < 0).all() else ""
        handles.append(Patch(fc=(*mpl.colors.to_rgb(color), 0.18), ec=color, hatch=hatch, label=region.name + empty))
    x, y = plane.names
    axis.set_xlabel(f"{x} [{scenario.state[x]}]")
    axis.set_ylabel(f"{y} [{scenario.state[y]}]")
    axis.set_xlim(plane.x[0], plane.x[-1])
    axis.set_ylim(plane.y[0], plane.y[-1])
    if scenario.state[x] == scenario.state[y]:
        axis.set_aspect("equal")
    axis.grid(color="0.92", zorder=0)
    axis.set_axisbelow(True)
    axis.legend(handles=handles, title="regions", loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False)


def _draw_activity(axis: Axes, scenario: Scenario, activity: Activity, shown: list[int]) -> None:
    half = activity.sample_time / 2
    for row, p in enumerate(shown):
        for active, color in ((activity.some, _IN_SOME_CASE), (activity.always, _IN_ANY_CASE)):
            bars = [(start - half, end - start + 2 * half) for start, end in spans(active[:, p], activity.sample_time)]
            axis.broken_barh(bars, (row - _BAR / 2, _BAR), fc=color, lw=0)
    axis.set_yticks(range(len(shown)), [_shortened(scenario.predicates[p].name) for p in shown], fontsize=8)
    axis.set_ylim(max(len(shown), 1) - 0.4, -0.6)
    end = (len(activity.some) - 1) * activity.sample_time
    axis.set_xlim(-0.01 * end - half, 1.01 * end + half)
    axis.set_xlabel(f"time since time zero [s], a sample each {activity.sample_time:g} s")
    axis.grid(axis="x", color="0.9")
    axis.set_axisbelow(True)
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    axis.tick_params(axis="y", length=0)
    handles = [
        Patch(fc=_IN_ANY_CASE, label="asked for in any case"),
        Patch(fc=_IN_SOME_CASE, label="asked for in some case"),
    ]
    axis.legend(handles=handles, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False, fontsize=8)


def _shortened(name: str) -> str:
    return name if len(name) <= _NAME_LENGTH else name[: _NAME_LENGTH - 1] + "…"
