"""The parking lot's formula and the paper's encoding of it: what each costs and whom it loses."""

import random

import numpy as np

from benchmarks.formulas import Atoms, random_tree, satisfied, text_of
from benchmarks.report import Cell, Claim, Table
from fleet_bus.messages import EventKind
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine, PlannedInputs
from reach_server.numeric.types import FloatArray
from reach_server.predicates import Context, Literals
from reach_server.sets.kernels import membership
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
    formulas, satisfying, checked, missed, events, ratio = _random(drives, parameters, 3 if quick else 40)
    rows.append((f"{formulas} random formulas", satisfying, 0, checked, missed, events, ratio))
    return Table(
        "The formula of the parking lot, and the paper's encoding of it",
        "Simulated drives that satisfy the formula and come to the gate between 24 s and 25 s. 'Broken': drives whose "
        "true states violate the encoding. 'Lost': true states outside the tubes of the engine from "
        f"{LOOKS_FROM} s on for three seconds, all ten steps; where a scenario turns out to be false the event comes, "
        "the vehicle is cut no more, and the losses end. 'Area': of the tenth step, mean ratio to that without side "
        "information. The random formulas are nested up to three operators deep; their drives are those that satisfy "
        "them, from the same moment on for two seconds.",
        ("scenario", "drives", "broken", "steps checked", "lost", "events", "area"),
        rows,
        [
            Claim("random formulas: true states lost", float(missed), "≤", 0.0),
            Claim("random formulas: steps checked", float(checked), "≥", 1000.0 if quick else 100_000.0),
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
        status = literals.verdict(range(literals.count), points[:, k], exact, context)
        beliefs = [
            table.after(belief, frozenset(np.flatnonzero(row < 0).tolist()))
            for belief, row in zip(beliefs, status, strict=True)
        ]
    return sum(belief == DEAD for belief in beliefs)


def _random(drives: list[Drive], parameters: SveaParameters, count: int) -> tuple[int, int, int, int, int, float]:
    """(formulas, drives that satisfy one, steps checked, true states outside, contradictions, area ratio)."""
    rng = random.Random(0)
    first = round(LOOKS_FROM / parameters.dt)
    positions = np.stack([drive.truth[:, :2] for drive in drives])
    totals, ratios, satisfying, made = np.zeros(3, dtype=np.int64), [], 0, 0
    while made < count:
        atoms = Atoms(rng, positions[:, first : first + 60].reshape(-1, 2))
        tree = random_tree(rng, 3, atoms)
        which = np.flatnonzero(satisfied(tree, positions, first, atoms))
        if not 0 < len(which) <= 0.7 * len(drives):
            continue
        made, satisfying = made + 1, satisfying + len(which)
        scenario = Scenario.parse(
            "scenario: random\nversion: 1\nstate: {x1: m, x2: m}\ntime: {zero: on_start}\n"
            f"assume: '{text_of(tree, atoms, round(parameters.dt * 1000))}'\n"
        )
        chosen = [drives[i] for i in which]
        *found, ratio = _tubes(chosen, scenario, parameters, time_zero=first, seconds=2.0)
        totals += found
        ratios.append(ratio)
    checked, missed, events = totals.tolist()
    return made, satisfying, checked, missed, events, float(np.mean(ratios))


def _tubes(
    drives: list[Drive], scenario: Scenario, parameters: SveaParameters, time_zero: int = 0, seconds: float = 3.0
) -> tuple[int, int, int, float]:
    """(steps checked, true states outside, contradictions, area with over area without at the last step), of a scenario
    that begins with the sample ``time_zero``."""
    engine = Engine(profile(parameters))
    vehicles = [f"v{i}" for i in range(len(drives))]
    for vehicle in vehicles:
        engine.add(vehicle)
    first = round(LOOKS_FROM / parameters.dt)
    last = first + round(seconds / parameters.dt)
    engine.append(SampleBatch.join([_samples(d, slot, 0, first, parameters) for slot, d in enumerate(drives)]))
    for vehicle in vehicles:
        engine.assign(vehicle, scenario, START + time_zero * parameters.dt_ns)
    checked = missed = events = 0
    ratios: list[FloatArray] = []
    for k in range(first, last):
        batch = SampleBatch.join([_samples(d, slot, k, k + 1, parameters) for slot, d in enumerate(drives)])
        plan = np.stack([d.inputs[k + 1 : k + engine.horizon] for d in drives])
        tubes = engine.step(batch, PlannedInputs(plan, np.zeros((len(drives), plan.shape[2]))))
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
