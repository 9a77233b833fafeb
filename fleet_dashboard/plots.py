"""Figures over time."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from nicegui import ui

from fleet_dashboard.history import Series
from fleet_dashboard.picture import Floats, Singles

_INK: Final = "#8a95a1"

#: Title, unit factor and the columns with their names and colours.
_Plot = tuple[str, float, Sequence[tuple[str, str, str]]]
FLEET: Final[Sequence[_Plot]] = (
    (
        "area of the last step, mean, m²",
        1,
        (("area", "with side information", "#1a9e7a"), ("area_free", "without", "#d08a16")),
    ),
    ("latency, ms", 1e3, (("latency_p50", "median", "#2f8fd0"), ("latency_p99", "99 %", "#8e3b9e"))),
    ("coverage of the newest checks, %", 100, (("coverage", "mean", "#1a9e7a"),)),
    ("a second", 1, (("samples", "samples", "#2f8fd0"), ("tubes", "tubes", "#1a9e7a"))),
)
VEHICLE: Final[Sequence[_Plot]] = (
    (
        "area of the last step, m²",
        1,
        (("area", "with side information", "#1a9e7a"), ("area_free", "without", "#d08a16")),
    ),
    ("latency, ms", 1e3, (("latency", "latency", "#2f8fd0"),)),
    ("coverage, %", 100, (("coverage", "coverage", "#1a9e7a"),)),
)


class Plots:
    """Plots, one below the other, of a fleet or of one vehicle."""

    def __init__(self, plots: Sequence[_Plot], columns: Sequence[str]) -> None:
        self._plots, self._columns = plots, list(columns)
        self._charts = []
        for title, factor, lines in plots:
            ui.label(title).classes("text-xs fleet-quiet q-px-sm q-pt-xs")
            self._charts.append(
                ui.echart(_options(lines, 100 if factor == 100 else None)).classes("w-full").style("height:130px")
            )

    def refresh(self, times: Floats, figures: Floats | Singles) -> None:
        """Show figures (T, F) at Unix seconds (T,)."""
        stamps = (1e3 * times).round().tolist()
        for (_, factor, lines), chart in zip(self._plots, self._charts, strict=True):
            series: list[dict[str, Any]] = chart.options["series"]
            for (column, _, _), line in zip(lines, series, strict=True):
                values = figures[:, self._columns.index(column)].astype(np.float64) * factor
                known = np.isfinite(values)
                line["data"] = [
                    [t, float(f"{v:.4g}") if k else None]
                    for t, v, k in zip(stamps, values.tolist(), known.tolist(), strict=True)
                ]
            chart.update()


def fleet_plots() -> Plots:
    """Plots of the fleet."""
    return Plots(FLEET, Series.FLEET)


def vehicle_plots() -> Plots:
    """Plots of one vehicle."""
    return Plots(VEHICLE, Series.VEHICLE)


def _options(lines: Sequence[tuple[str, str, str]], most: float | None) -> dict[str, Any]:
    return {
        "animation": False,
        "grid": {"left": 8, "right": 16, "top": 22 if len(lines) > 1 else 8, "bottom": 4, "containLabel": True},
        "legend": {"show": len(lines) > 1, "top": 0, "itemHeight": 8, "textStyle": {"color": _INK, "fontSize": 11}},
        "tooltip": {"trigger": "axis", "confine": True},
        "xAxis": {"type": "time", "axisLabel": {"color": _INK, "hideOverlap": True}},
        "yAxis": {
            "type": "value", "scale": True, "max": most, "splitNumber": 3, "axisLabel": {"color": _INK},
            "splitLine": {"lineStyle": {"color": _INK, "opacity": 0.2}},
        },
        "series": [
            {
                "type": "line", "name": name, "showSymbol": False, "lineStyle": {"width": 1.5}, "color": colour,
                "data": [],
            }
            for _, name, colour in lines
        ],
    }  # fmt: skip
