"""How the cost of an update grows with window, horizon, vehicles, predicates and dimension."""

from matplotlib.figure import Figure

from benchmarks import plots
from benchmarks.report import Cell, Table
from benchmarks.timing import spread
from benchmarks.updates import HORIZON, METHODS, PREDICATES, WINDOW, measure, published_seconds, samples
from fleet_lab import fleets
from fleet_lab.fleets import Drives

VEHICLES, UPDATES, REPEATS = 100, 24, 7
AXES: dict[str, tuple[int, ...]] = {
    "window": (500, 1000, 2000, 4000),
    "horizon": (5, 10, 20, 40),
    "vehicles": (1, 10, 100, 1000),
    "predicates": (0, 1, 2, 4, 8),
    "dimension": (2, 4, 6, 8),
}
UNITS = {"window": "T", "horizon": "N", "vehicles": "V", "predicates": "P", "dimension": "n"}
#: Axes over which one vehicle is set beside the published form.
BESIDE = ("window", "horizon")
ALONE, PUBLISHED = "paper, one vehicle", "as published, one vehicle"


def run(quick: bool) -> Table:
    """Microseconds a vehicle and update, each number varied alone."""
    usual = {"window": 400 if quick else WINDOW, "horizon": HORIZON, "vehicles": 2 if quick else VEHICLES,
             "predicates": PREDICATES, "dimension": 0}  # fmt: skip
    updates, methods = (5, METHODS[:1]) if quick else (UPDATES, METHODS)
    rows: list[tuple[Cell, ...]] = []
    # The usual case lies on several curves.
    known: dict[tuple[object, ...], tuple[float, ...]] = {}

    def times(drives: Drives, sizes: dict[str, int], method: str) -> tuple[float, ...]:
        case = (*sizes.values(), method)
        if case not in known:
            found = measure(drives, sizes["vehicles"], method, sizes["predicates"], updates).seconds
            known[case] = tuple(second / sizes["vehicles"] for second in found)
        return known[case]

    for axis, values in AXES.items():
        for value in values[:1] if quick else values:
            sizes = {**usual, axis: value}
            drives = _drives(sizes, updates)
            found = {method: times(drives, sizes, method) for method in methods}
            if axis in BESIDE:
                found[ALONE] = times(drives, {**sizes, "vehicles": 1}, "paper")
                found[PUBLISHED] = tuple(published_seconds(drives, 2 if quick else REPEATS, matrix_zonotope=False))
            rows += [(axis, value, name, *spread(t, 1e6), max(t) * 1e6) for name, t in found.items()]
    return Table(
        "How the cost of an update grows",
        f"Where not varied: window of {usual['window']}, horizon {HORIZON}, {usual['vehicles']} vehicles in one batch, "
        f"{PREDICATES} predicates, the car of 4 states in the body frame; over the dimension linear systems in the "
        "world frame. Over window and horizon one vehicle alone, too, beside the published form with one vehicle, at "
        "its fastest: without the matrix zonotope of the noise.",
        ("varied", "to", "method", "µs a vehicle and update", "25 %", "75 %", "longest"),
        rows,
        keys=3,
    )


def _drives(sizes: dict[str, int], updates: int) -> Drives:
    length = samples(sizes["window"], sizes["horizon"], updates)
    changes = {"window": sizes["window"], "horizon": sizes["horizon"]}
    if sizes["dimension"]:
        return fleets.linear(length, sizes["dimension"], **changes)
    return fleets.cars(length, **changes)


def plot(table: Table) -> Figure:
    """A panel for each number that is varied; bands between the quartiles."""
    made = plots.figure(10, 6.5)
    places = made.subplots(2, 3, sharey=True).flat
    for place, axis in zip(places, AXES, strict=False):
        log = axis in ("window", "horizon", "vehicles")
        label = f"{axis} ({UNITS[axis]})"
        plots.curves(place, plots.lines(table, axis), label, "µs a vehicle and update", log=log)
    places[-1].axis("off")
    places[-1].legend(*places[0].get_legend_handles_labels(), loc="center", frameon=False)
    return made
