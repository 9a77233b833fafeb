"""How the cost of an update grows with window, horizon, vehicles, predicates and dimension."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks import fleets
from benchmarks.report import Cell, Table
from benchmarks.updates import HORIZON, METHODS, PREDICATES, WINDOW, measure, samples

VEHICLES, UPDATES = 100, 12
AXES: dict[str, tuple[int, ...]] = {
    "window": (500, 1000, 2000, 4000),
    "horizon": (5, 10, 20, 40),
    "vehicles": (1, 10, 100, 1000),
    "predicates": (0, 1, 2, 4, 8),
    "dimension": (2, 4, 6, 8),
}
UNITS = {"window": "T", "horizon": "N", "vehicles": "V", "predicates": "P", "dimension": "n"}


def run(quick: bool) -> Table:
    """Microseconds a vehicle and update, each number varied alone."""
    rows: list[tuple[Cell, ...]] = []
    usual = {"window": 400 if quick else WINDOW, "horizon": HORIZON, "vehicles": 2 if quick else VEHICLES,
             "predicates": PREDICATES, "dimension": 0}  # fmt: skip
    for axis, values in AXES.items():
        for value in values[:1] if quick else values:
            sizes = {**usual, axis: value}
            window, horizon = sizes["window"], sizes["horizon"]
            length = samples(window, horizon, UPDATES)
            changes = {"window": window, "horizon": horizon}
            drives = fleets.linear(length, value, **changes) if axis == "dimension" else fleets.cars(length, **changes)
            for method in METHODS:
                found = measure(drives, sizes["vehicles"], method, sizes["predicates"], UPDATES)
                rows.append((axis, value, method, found.median / sizes["vehicles"] * 1e6))
    return Table(
        "How the cost of an update grows",
        f"Where not varied: window of {usual['window']}, horizon {HORIZON}, {usual['vehicles']} vehicles in one batch, "
        f"{PREDICATES} predicates, the car of 4 states in the body frame; over the dimension linear systems in the "
        "world frame.",
        ("varied", "to", "method", "µs a vehicle and update"),
        rows,
    )


def plot(table: Table, folder: Path) -> Path:
    """Draw the rows of ``run`` into ``folder/update-cost.png``."""
    figure = Figure(figsize=(10, 6.5), layout="constrained")
    FigureCanvasAgg(figure)
    places = figure.subplots(2, 3, sharey=True).flat
    for place, axis in zip(places, AXES, strict=False):
        for method in METHODS:
            points = [(row[1], row[3]) for row in table.rows if (row[0], row[2]) == (axis, method)]
            place.plot(*zip(*points, strict=True), marker="o", markersize=4, label=method)
        if axis in ("window", "horizon", "vehicles"):
            place.set_xscale("log")
        place.set_yscale("log")
        place.set_xticks(AXES[axis], [str(value) for value in AXES[axis]])
        place.minorticks_off()
        place.set_xlabel(f"{axis} ({UNITS[axis]})")
        place.set_ylabel("µs a vehicle and update")
        place.grid(alpha=0.3)
    places[-1].axis("off")
    places[-1].legend(*places[0].get_legend_handles_labels(), loc="center", frameon=False)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "update-cost.png"
    figure.savefig(path, dpi=110, metadata={"Software": None})
    return path
