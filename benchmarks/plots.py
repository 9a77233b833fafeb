"""What the plots of the suite share."""

from collections.abc import Callable, Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.page import text
from benchmarks.report import Cell, Table

#: A point of a curve, and the ends of its band where it has one.
Point = tuple[float, float, float, float]
#: What a row is called.
Label = Callable[[Sequence[Cell]], str]


def figure(width: float, height: float) -> Figure:
    """An empty figure, inches."""
    made = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(made)
    return made


def lines(table: Table, axis: str) -> dict[str, list[Point]]:
    """Curves of a table whose columns are: what is varied, to what, name of the curve, median, and quartiles."""
    found: dict[str, list[Point]] = {}
    for varied, x, name, *band in table.rows:
        if varied == axis:
            middle, low, high = (float(str(value)) for value in band[:3])
            found.setdefault(str(name), []).append((float(str(x)), middle, low, high))
    return found


def curves(place: Axes, drawn: Mapping[str, Sequence[Point]], label: str, unit: str, *, log: bool) -> None:
    """Medians with bands over one number; the vertical axis is logarithmic, the other one if ``log``."""
    ticks: set[float] = set()
    for name, points in drawn.items():
        x, middle, low, high = zip(*points, strict=True)
        ticks.update(x)
        (line,) = place.plot(x, middle, marker="o", markersize=4, label=name)
        place.fill_between(x, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
    place.set_yscale("log")
    if log:
        place.set_xscale("log")
    place.set_xticks(sorted(ticks), [f"{tick:g}" for tick in sorted(ticks)])
    place.minorticks_off()
    place.set_xlabel(label)
    place.set_ylabel(unit)
    place.grid(alpha=0.3)


def bars(table: Table, group: Label, name: Label, value: int, unit: str) -> Figure:
    """A panel of horizontal bars for each group of rows, on one logarithmic axis; ``value`` is a column."""
    groups: dict[str, list[tuple[str, float]]] = {}
    for row in table.rows:
        cell = row[value]
        if isinstance(cell, int | float) and cell > 0:
            groups.setdefault(group(row), []).append((name(row), float(cell)))
    heights = [len(rows) + 1 for rows in groups.values()]
    made = figure(9, 0.6 + 0.26 * sum(heights))
    places = made.subplots(len(groups), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for place, (title, rows) in zip(places, groups.items(), strict=True):
        names, values = zip(*rows, strict=True)
        drawn = place.barh(range(len(rows)), values, color=[f"C{i}" for i in range(len(rows))], height=0.7)
        place.bar_label(drawn, [text(v) for v in values], padding=3, fontsize=8)
        place.set_yticks(range(len(rows)), names, fontsize=8)
        place.invert_yaxis()
        place.set_xscale("log")
        place.margins(x=0.15)
        place.set_title(title, fontsize=9, loc="left")
        place.grid(axis="x", alpha=0.3)
    places[-1].set_xlabel(unit)
    return made
