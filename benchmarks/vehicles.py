"""One tube for each of 1000 vehicles: all in one batch, and one call per vehicle."""

import numpy as np
from numpy.typing import NDArray

from benchmarks.report import Cell, Claim, Table
from benchmarks.timing import median_seconds, seconds
from reach_server.data.input_sets import InputSets
from reach_server.data.regressors import RegressorSpec, transitions
from reach_server.data.window import Block
from reach_server.models.residual_model import NoiseBounds, fit
from reach_server.numeric.slot_table import take_rows
from reach_server.predicates import Context, Literals
from reach_server.predicates.cut_kinds import CutMethod
from reach_server.sets.raw import RawSets
from reach_server.tube.branching import Hypotheses, SideInformation, Tube, propagate
from reach_server.tube.recursion import Recursion
from side_info import LinearPredicate
from side_info.progression import Grid
from side_info.progression import Table as Obligations
from side_info.stl.nnf import Conjunction, Globally, Literal
from vehicle_agent.simulate import simulate_history
from vehicle_agent.svea import SveaParameters, profile

HORIZON, SAMPLES = 10, 200


def run(quick: bool) -> Table:
    """Milliseconds a vehicle for ten steps with two strips each."""
    vehicles = 50 if quick else 1000
    parameters = SveaParameters()
    svea = profile(parameters)
    layout = RegressorSpec.of(svea)
    bounds = NoiseBounds.of(svea, layout)
    drive = simulate_history(1, SAMPLES, parameters)
    yes = np.ones((1, SAMPLES), dtype=bool)
    linked = yes.copy()
    linked[:, 0] = False
    times = np.arange(SAMPLES, dtype=np.int64)[None] * parameters.dt_ns
    block = Block(times, drive.measured[None], drive.inputs[None], yes, yes, linked)
    model = take_rows(
        fit(transitions(block, layout), layout, bounds, svea.lipschitz), np.zeros(vehicles, dtype=np.intp)
    )

    rng = np.random.default_rng(0)
    states = np.column_stack([
        rng.uniform(-3.9, 3.9, (vehicles, 2)), rng.uniform(-3, 3, vehicles), rng.uniform(0.2, 1.5, vehicles),
    ])  # fmt: skip
    limit = np.array([parameters.steering_limit, parameters.velocity_limit])
    known = rng.uniform(-0.5, 0.5, (vehicles, layout.lags + HORIZON, 2)) * limit
    inputs = InputSets(
        known[:, : layout.lags], known[:, layout.lags :], np.broadcast_to(0.1 * limit, (vehicles, HORIZON, 2))
    )
    start = RawSets.zonotope(states, np.broadcast_to(bounds.measurement, (vehicles, *bounds.measurement.shape)))
    # A corridor along each axis, always, near the border of which some of the vehicles are.
    literals = Literals(layout.n, (0, 1), np.zeros((layout.n, 0)))
    names = [
        literals.add(LinearPredicate(name, {name: 1.0}, -4.0, 4.0), {"x": 0, "y": 1}, scenario="lot", name=name)
        for name in ("x", "y")
    ]
    obligations = Obligations()
    always = Globally(0, 2 * HORIZON * parameters.dt_ns, Conjunction((Literal(0), Literal(1))))
    root = obligations.add(always, Grid(parameters.dt_ns), lambda predicate, _: names[predicate])

    rows: list[tuple[Cell, ...]] = []
    claims: list[Claim] = []
    methods: tuple[CutMethod, ...] = ("zonotope", "constrained")
    for cuts in methods:
        knowledge = SideInformation(obligations, literals, lambda k, track: _nowhere, cuts, (0, 1))

        def tube(which: slice, knowledge: SideInformation = knowledge) -> Tube:
            motion = Recursion(take_rows(inputs, which), take_rows(model, which), bounds.process, layout)
            sets = take_rows(start, which)
            each = np.arange(len(sets.center))
            tracks = Hypotheses(each, sets, each, np.full(len(each), root), np.ones(len(each), dtype=bool))
            return propagate(tracks, motion, knowledge, layout.n)

        batch = median_seconds(lambda: tube(slice(None)), 3) / vehicles
        tube(slice(0, 1))
        single, alone = seconds(lambda: [tube(slice(i, i + 1)) for i in range(vehicles)])
        single /= vehicles
        rows.append((cuts, vehicles, batch * 1e3, single * 1e3, single / batch, _difference(tube(slice(None)), alone)))
        text = f"tubes of {vehicles} vehicles, cuts {cuts}: single calls over one batch"
        claims.append(Claim(text, single / batch, "≥", 1.0))
    return Table(
        "Tubes of many vehicles",
        f"`reach_server.tube.branching.propagate`, {HORIZON} steps, {SAMPLES} samples in the window, two strips a "
        "step, the same vehicles both ways. 'Difference' is the greatest one in any half-width of an interval hull, "
        "relative to it; "
        "constrained sets of a batch share their rows, and so drop the oldest at other moments than a set alone.",
        ("cuts", "vehicles", "ms a vehicle, one batch", "ms a vehicle, single calls", "ratio", "difference"),
        rows,
        claims,
        keys=2,
    )


def _nowhere(literal: int, rows: NDArray[np.intp]) -> Context:
    """These predicates refer to the state alone."""
    nothing = np.zeros((len(rows), 0))
    zero = np.zeros(len(rows))
    return Context(zero, zero, zero, nothing, nothing)


def _difference(batch: Tube, alone: list[Tube]) -> float:
    worst = 0.0
    for k, step in enumerate(batch.steps):
        half = np.abs(step.sets.generators).sum(axis=-1)
        single = np.stack([np.abs(tube.steps[k].sets.generators).sum(axis=-1)[0] for tube in alone])
        worst = max(worst, float((np.abs(half - single) / half).max()))
    return worst
