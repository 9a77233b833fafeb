"""Models of known dynamics, their tubes, and true trajectories that must stay in these."""

import numpy as np
import pytest
from numpy.typing import NDArray

from fleet_bus.messages import VehicleProfile
from reach_server.data.input_sets import InputSets
from reach_server.data.regressors import transitions
from reach_server.models.residual_model import Model, NoiseBounds, fit
from reach_server.numeric.types import FloatArray
from reach_server.predicates import Context, Literals
from reach_server.predicates.apply import CutSets, cut_sets
from reach_server.predicates.cut_kinds import CutMethod
from reach_server.sets.raw import RawSets
from reach_server.tube.branching import Branches, Hypotheses, SideInformation, Tube, propagate
from reach_server.tube.recursion import Recursion
from side_info import Scenario
from side_info.progression import TRUE, Grid, Table
from tests.reach_server.drives import LAYOUT, PROFILE, SVEA, World, block_of, history, inside, noise
from tests.reach_server.ugly import Raw, assert_holds
from vehicle_agent.svea import step as svea_step

WORLD = World()
HORIZON = 10
COUNT = 3000
cut_methods = pytest.mark.parametrize("cuts", ["zonotope", "constrained", "frobenius"])


class Side:
    """A scenario as the tube sees it: its table, its literals over the states of a profile, and its root."""

    def __init__(self, scenario: Scenario | None, profile: VehicleProfile, step_ns: int = SVEA.dt_ns) -> None:
        n = len(profile.state)
        self.table = Table()
        self.literals = Literals(n, (0, 1), np.zeros((n, 0)))
        self.root = TRUE
        if scenario is not None:
            index = scenario.state_indices(profile)

            def literal(number: int, margin_ns: int) -> int:
                predicate = scenario.predicates[number]
                return self.literals.add(predicate, index, scenario=scenario.name, name=predicate.name)

            self.root = self.table.add(scenario.side_information, Grid(step_ns), literal)

    @staticmethod
    def contexts(literal: int, rows: NDArray[np.intp]) -> Context:
        """Nothing that a predicate of these tests refers to."""
        zero = np.zeros(len(rows))
        return Context(zero, zero, zero, np.zeros((len(rows), 4)), np.zeros((len(rows), 4)))

    def side(self, cuts: CutMethod = "zonotope") -> SideInformation:
        """For ``propagate``."""
        return SideInformation(self.table, self.literals, lambda k, track: self.contexts, cuts, (0, 1))

    def cut_all(self, start: RawSets, asked: NDArray[np.bool_], cuts: CutMethod) -> CutSets:
        """Sets cut by the literals asked for."""
        return cut_sets(start, asked, self.literals, self.contexts, cuts, 2, (0, 1))


def tube_of(
    start: RawSets,
    motion: Recursion,
    side: Side | None = None,
    cuts: CutMethod = "zonotope",
) -> Tube:
    """One tube per row of ``start``, all with the side information, or none."""
    known = Side(None, WORLD.profile) if side is None else side
    rows = np.arange(len(start.center))
    tracks = Hypotheses(rows, start, rows, np.full(len(rows), known.root), np.ones(len(rows), dtype=bool))
    return propagate(tracks, motion, known.side(cuts), motion.layout.n)


def spread(rng: np.random.Generator, center: FloatArray, half: FloatArray, count: int) -> FloatArray:
    """Members (count, …) of a box, a third at corners, a third at one corner for good (extreme for all steps)."""
    share = rng.uniform(-1, 1, (count, *center.shape))
    third = count // 3
    share[:third] = np.sign(share[:third])
    share[third : 2 * third] = np.sign(rng.uniform(-1, 1, (third, 1, *center.shape[1:])))
    return np.asarray(center + share * half)


def world_truth(rng: np.random.Generator, start: FloatArray, u: FloatArray, past: FloatArray) -> FloatArray:
    """States (COUNT, HORIZON + 1, 2) from initial states under inputs (COUNT, HORIZON, 1)."""
    states = [start]
    for k in range(u.shape[1]):
        lagged = u[:, k - 1] if k else np.broadcast_to(past, (len(start), 1))
        xi = np.concatenate([states[-1], u[:, k], lagged], axis=1)
        states.append(WORLD.f(xi) + noise(rng, WORLD.process, len(start)))
    return np.stack(states, axis=1)


def svea_truth(rng: np.random.Generator, start: FloatArray, u: FloatArray, past: FloatArray) -> FloatArray:
    """States (COUNT, HORIZON + 1, 4); ``past`` (2, 2) are the last inputs, newest first."""
    states = [start]
    steering = [np.full(len(start), past[1, 0]), np.full(len(start), past[0, 0]), *u[..., 0].T]
    for k in range(u.shape[1]):
        w = noise(rng, np.diag(SVEA.process_noise), len(start))
        states.append(svea_step(SVEA, states[-1], steering[k], u[:, k, 1], w))
    return np.stack(states, axis=1)


def two_vehicles(model: Model) -> Model:
    """The same model for two vehicles."""
    return Model(**{name: np.concatenate([getattr(model, name)] * 2) for name in Model.__slots__})


def world_model(seed: int) -> Model:
    drive = WORLD.drive(seed)
    data = transitions(block_of(drive.measured, drive.inputs), WORLD.layout)
    return fit(data, WORLD.layout, NoiseBounds.of(WORLD.profile, WORLD.layout), WORLD.profile.lipschitz)


def svea_model(seed: int) -> Model:
    drive = history(seed)
    bounds = NoiseBounds.of(PROFILE, LAYOUT)
    return fit(transitions(block_of(drive.measured, drive.inputs), LAYOUT), LAYOUT, bounds, PROFILE.lipschitz)


def assert_all_inside(tube: Tube, truth: FloatArray, rng: np.random.Generator) -> None:
    """Every true state lies in one of the branches of the only track."""
    for k, step in enumerate(tube.steps):
        sets = step.sets
        held = np.any([inside(sets, row, truth[:, k], rng) for row in range(len(step.track))], axis=0)
        assert held.all(), (k, int((~held).sum()))
        if len(step.track) == 1:
            case = Raw("", sets.center[0], sets.generators[0], sets.matrix[0], sets.offset[0])
            assert_holds(case, truth[:2, k])


def only(step: Branches) -> RawSets:
    """The set of a step, where every track has one branch."""
    assert np.array_equal(step.track, np.arange(len(step.track)))
    return step.sets


def svea_tube(
    seed: int, heading: float, wide: bool, membership: bool, order: int = 5
) -> tuple[Tube, FloatArray, np.random.Generator]:
    rng = np.random.default_rng(seed)
    measurement = np.diag([0.01, 0.02, heading, 0.05])
    y = np.array([3.0, -2.0, rng.uniform(-3, 3), rng.uniform(-1, 1)])
    limit = np.array([SVEA.steering_limit, SVEA.velocity_limit])
    past = rng.uniform(-1, 1, (2, 2)) * limit
    half = limit * (rng.uniform(0.3, 1.0) if wide else 0.02) * np.ones((HORIZON, 1))
    center = rng.uniform(-1, 1, (HORIZON, 2)) * (limit - half)
    motion = Recursion(
        InputSets(past[None], center[None], half[None]), svea_model(seed), np.diag(SVEA.process_noise), LAYOUT,
        membership, order,
    )  # fmt: skip
    tube = tube_of(RawSets.zonotope(y[None], measurement[None]), motion)
    truth = svea_truth(rng, y - noise(rng, measurement, COUNT), spread(rng, center, half, COUNT), past)
    return tube, truth, rng
