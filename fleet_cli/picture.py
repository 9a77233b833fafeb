"""The picture of a demo: paths, and where each vehicle could be next, with and without side information."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from fleet_bus.errors import UsageError
from fleet_bus.messages import StateSample
from fleet_cli.monitor import Monitor
from fleet_cli.scenario_activity import activity
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine, PlannedInputs
from reach_server.engine.results import Tubes
from reach_server.numeric.types import FloatArray
from reach_server.predicates import Literals
from reach_server.sets import polygon as planar
from reach_server.tube.summaries import PlaneStrips, summarize
from side_info.documents.scenario import Scenario

#: Instants shown, as parts of the scenario's length.
INSTANTS = (0.3, 0.625, 0.85)
#: Vehicles shown.
SHOWN = 4
#: Largest coordinate that the picture can need, m.
FAR = 50.0


def draw_demo(monitor: Monitor, scenario: Scenario, path: Path) -> None:
    """Draw three instants of what a monitor saw; raise ``UsageError`` if the file cannot be written."""
    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "fleet-reach"
    vehicles = sorted(monitor.assignments)[:SHOWN]
    figure = Figure(figsize=(12, 5.2), layout="constrained")
    axes = figure.subplots(1, len(INSTANTS), sharex=True, sharey=True)
    for axis, part in zip(axes, INSTANTS, strict=True):
        elapsed = part * scenario.end_ns
        _draw_region(axis, monitor, scenario, vehicles, round(elapsed))
        for number, vehicle in enumerate(vehicles):
            _draw_vehicle(axis, monitor, scenario, vehicle, round(elapsed), f"C{number}")
        axis.set_title(f"{elapsed / 1e9:.0f} s")
        axis.set_xlabel("x1 [m]")
        axis.set_aspect("equal")
    axes[0].set_ylabel("x2 [m]")
    _fit(axes[0], monitor)
    handles = [
        Polygon(np.zeros((1, 2)), closed=True, fc="none", ec="0.45", ls="--", label="without side information"),
        Polygon(np.zeros((1, 2)), closed=True, fc="C0", alpha=0.45, label="with side information"),
        Polygon(np.zeros((1, 2)), closed=True, fc="0.93", ec="0.75", label="where the scenario says the vehicles are"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(f"{scenario.name}: guaranteed sets of the coming {_horizon(monitor):.2g} s")
    try:
        figure.savefig(path, dpi=110, metadata={"Date": None} if path.suffix == ".svg" else None)
    except (OSError, ValueError) as error:
        raise UsageError(f"--picture {path}: cannot be drawn: {error}; choose a .png, .svg or .pdf file") from None


def _horizon(monitor: Monitor) -> float:
    tube = next(iter(monitor.newest.values()))
    return float(tube.times[-1] - tube.t) / 1e9


def _fit(axis: Axes, monitor: Monitor) -> None:
    points = np.array([truth.x[:2] for truth in monitor.truths.values()])
    low, high = points.min(axis=0) - 0.5, points.max(axis=0) + 0.5
    axis.set_xlim(low[0], high[0])
    axis.set_ylim(low[1], high[1])


def _draw_region(axis: Axes, monitor: Monitor, scenario: Scenario, vehicles: list[str], elapsed: int) -> None:
    """Where the scenario says that vehicles are at an instant, whatever they do before."""
    profile = monitor.profiles[vehicles[0]]
    index = scenario.state_indices(profile)
    literals = Literals(len(profile.state), profile.position, np.zeros((len(profile.state), 0)))
    step = elapsed // profile.sample_time_ns
    for number in np.flatnonzero(activity(scenario, profile.sample_time).always[step]).tolist():
        predicate = scenario.predicates[number]
        literals.add(predicate, index, scenario=scenario.name, name=predicate.name)
    strips = PlaneStrips.of(literals, range(literals.count), len(profile.state), profile.position)
    vertices = FAR * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    for c in range(len(strips.literal)):
        vertices = planar.clip(vertices, strips.normal[c], np.array(strips.upper[c]))
        vertices = planar.clip(vertices, -strips.normal[c], np.array(-strips.lower[c]))
    axis.add_patch(Polygon(vertices, closed=True, fc="0.93", ec="0.75", zorder=0))


def _draw_vehicle(axis: Axes, monitor: Monitor, scenario: Scenario, vehicle: str, elapsed: int, color: str) -> None:
    zero = monitor.assignments[vehicle].time_zero
    past = np.array(
        [t.x[:2] for key, t in sorted(monitor.truths.items()) if key[0] == vehicle and t.t <= zero + elapsed]
    )
    if len(past):
        axis.plot(*past[-80:].T, color=color, lw=0.8, alpha=0.6)
    tubes = _tubes_at(monitor, scenario, vehicle, zero + elapsed)
    if tubes is None:
        return
    nothing = np.zeros((1, 0), dtype=bool)
    plane = monitor.profiles[vehicle].position
    for k in range(0, len(tubes.steps), 3):
        center = tubes.free[k].center[0, list(plane)]
        free: FloatArray = center + summarize(tubes.free[k], nothing, PlaneStrips.none(), plane).outline()[0]
        cut = tubes.steps[k].center[0, list(plane)] + tubes.outline[0, k]
        axis.add_patch(Polygon(free, closed=True, fc="none", ec="0.45", ls="--", lw=0.9))
        axis.add_patch(Polygon(cut, closed=True, fc=color, ec=color, alpha=0.45, lw=0.8))


def _tubes_at(monitor: Monitor, scenario: Scenario, vehicle: str, t: int) -> Tubes | None:
    """The tubes of one vehicle from its last sample not after ``t``, computed as the server does."""
    samples: list[StateSample] = [seen.message for key, seen in sorted(monitor.states.items()) if key[0] == vehicle]
    samples = [sample for sample in samples if sample.t <= t]
    if not samples:
        return None
    engine = Engine(monitor.profiles[vehicle])
    slot = engine.add(vehicle)
    engine.assign(vehicle, scenario, monitor.assignments[vehicle].time_zero)
    engine.append(SampleBatch.of(slot, samples[:-1]))
    plan = samples[-1].plan
    exactly = np.zeros((1, len(engine.profile.inputs)))
    known = None if plan is None else PlannedInputs(plan[None, : engine.horizon - 1], exactly)
    tubes = engine.step(SampleBatch.of(slot, samples[-1:]), known)
    return tubes if tubes.vehicles else None
