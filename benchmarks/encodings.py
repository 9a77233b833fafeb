"""The parking lot's formula and the paper's encoding of it: what each costs and whom it loses."""

import numpy as np

from benchmarks.report import Cell, Claim, Table
from fleet_bus.messages import EventKind
from reach_server.engine import Engine, KnownInputs
from reach_server.predicates import Context, Literals
from reach_server.sets import membership
from reach_server.windows import Floats, SampleBatch
from side_info import Scenario
from side_info.progression import DEAD, Grid
from side_info.progression import Table as Obligations
from vehicle_agent.route import Route, WayPoint, load_route
from vehicle_agent.simulate import Drive, simulate_drive
from vehicle_agent.svea import SveaParameters, profile

SCENARIOS = ("parking-lot", "parking-lot-paper")
#: The paper's window of the gate, s, and when the engine begins to look.
FROM, TO, LOOKS_FROM = 24.0, 25.0, 22.5
START = 10**18


def late_route() -> Route:
    """The route through the parking lot that comes to the gate just before 25 s, as the formula allows."""
    route = load_route("parking-lot")
    first = next(i for i, point in enumerate(route.way_points) if point.at == FROM)
    points = [
        *route.way_points[: first - 1],
        WayPoint(x=1.25, y=-0.45, speed=0.8, at=23.7, jitter=(0.1, 0.06)),
        WayPoint(x=0.5, y=-1.05, speed=0.8, at=24.9, jitter=(0.08, 0.08)),
        *route.way_points[first + 2 :],
    ]
    return route.model_copy(update={"way_points": points, "zones": [z for z in route.zones if z.name != "gate"]})


def run(quick: bool) -> Table:
    """Drives that satisfy the formula, held against both encodings: drives broken, states lost, events."""
    parameters = SveaParameters()
    count = 2 if quick else 24
    drives = [simulate_drive(late_route(), seed, parameters) for seed in range(count)]
    rows: list[tuple[Cell, ...]] = []
    lost: dict[str, int] = {}
    for name in SCENARIOS:
        scenario = Scenario.load(name)
        steps, missed, events, ratio = _tubes(drives, scenario, parameters)
        rows.append((name, count, _broken(drives, scenario, parameters), steps, missed, events, ratio))
        lost[name] = missed
    return Table(
        "The formula of the parking lot, and the paper's encoding of it",
        "Simulated drives that satisfy the formula and come to the gate between 24 s and 25 s. 'Broken': drives whose "
        "true states violate the encoding. 'Lost': true states outside the tubes of the engine from "
        f"{LOOKS_FROM} s to {TO + 0.5} s, all ten steps; where a scenario turns out to be false the event comes and "
        "the vehicle is cut no more, which ends the losses. 'Area': of the tenth step, mean ratio to that without side "
        "information.",
        ("scenario", "drives", "broken", "steps checked", "lost", "events", "area"),
        rows,
        [
            Claim("the formula itself: true states lost", float(lost["parking-lot"]), "≤", 0.0),
            Claim(
                "the paper's encoding: true states lost",
                float(lost["parking-lot-paper"]),
                "≥",
                10.0 if quick else 100.0,
            ),
        ],
    )


def _broken(drives: list[Drive], scenario: Scenario, parameters: SveaParameters) -> int:
    """Drives whose true states, without any noise, leave the formula no way to be fulfilled."""
    svea = profile(parameters)
    index = scenario.state_indices(svea)
    literals, table = Literals(len(svea.state), (0, 1), np.zeros((len(svea.state), 0))), Obligations()

    def literal(number: int, margin_ns: int) -> int:
        predicate = scenario.predicates[number]
        return literals.add(predicate, index, scenario=scenario.name, name=predicate.name)

    root = table.belief([table.add(scenario.side_information, Grid(parameters.dt_ns), literal)])
    beliefs = [root] * len(drives)
    points = np.stack([drive.truth for drive in drives])
    exact = np.zeros((len(drives), points.shape[2], 0))
    for k in range(points.shape[1]):
        nothing = np.zeros(len(drives))
        context = Context(nothing + k * parameters.dt, nothing, nothing, points[:, k], points[:, k])
        status = literals.status(range(literals.count), points[:, k], exact, context)
        beliefs = [
            table.after(belief, frozenset(np.flatnonzero(row < 0).tolist()))
            for belief, row in zip(beliefs, status, strict=True)
        ]
    return sum(belief == DEAD for belief in beliefs)


def _tubes(drives: list[Drive], scenario: Scenario, parameters: SveaParameters) -> tuple[int, int, int, float]:
    """(steps checked, true states outside, contradictions, area with over area without at the last step)."""
    engine = Engine(profile(parameters))
    vehicles = [f"v{i}" for i in range(len(drives))]
    for vehicle in vehicles:
        engine.add(vehicle)
    first, last = round(LOOKS_FROM / parameters.dt), round((TO + 0.5) / parameters.dt)
    engine.append(SampleBatch.join([_samples(d, slot, 0, first, parameters) for slot, d in enumerate(drives)]))
    for vehicle in vehicles:
        engine.assign(vehicle, scenario, START)
    checked = missed = events = 0
    ratios: list[Floats] = []
    for k in range(first, last):
        batch = SampleBatch.join([_samples(d, slot, k, k + 1, parameters) for slot, d in enumerate(drives)])
        plan = np.stack([d.inputs[k + 1 : k + engine.horizon] for d in drives])
        tubes = engine.step(batch, KnownInputs(plan, np.zeros((len(drives), plan.shape[2]))))
        events += sum(event.kind is EventKind.CONTRADICTION for event in tubes.events)
        ratios.append(tubes.area[:, -1] / tubes.area_free[:, -1])
        for h, sets in enumerate(tubes.steps):
            truth = np.stack([d.truth[k + 1 + h] for d in drives])
            truth[:, 2] = sets.center[:, 2] + np.mod(truth[:, 2] - sets.center[:, 2] + np.pi, 2 * np.pi) - np.pi
            held = membership.contains(sets.center, sets.generators, sets.matrix, sets.offset, truth)
            checked, missed = checked + len(drives), missed + int((~held).sum())
    return checked, missed, events, float(np.mean(ratios))


def _samples(drive: Drive, slot: int, first: int, last: int, parameters: SveaParameters) -> SampleBatch:
    k = np.arange(first, last)
    return SampleBatch(
        np.full(len(k), slot, dtype=np.intp), np.ones(len(k), dtype=np.uint64), k.astype(np.uint64),
        START + k * parameters.dt_ns, np.zeros(len(k), dtype=np.uint32), drive.measured[k], drive.inputs[k],
    )  # fmt: skip
