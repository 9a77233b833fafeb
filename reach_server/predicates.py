"""Predicates as cuts: from the regions of a scenario to strips over the state of a vehicle class.

A predicate ``h(x) >= 0`` may cut a set only so that no x with ``h(x) >= 0`` is lost. An affine one is a half-space or
a strip, exactly. Where h is concave, each tangent is valid without remainder: ``0 <= h(x*) + ∇h(x*)(x - x*)``; a
disc gives h = r² - |x - q|² and its tangents at points on its border. Gradients are symbolic (CasADi).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi
import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import VehicleProfile
from reach_server.windows import Floats, Ints
from side_info import DiscPredicate, LinearPredicate, Scenario

#: Tangents of a disc: 16 leave at most 1.3 % more than its own area, and pair up to 8 strips.
DISC_TANGENTS = 16


@dataclass(frozen=True, slots=True, eq=False)
class CutTable:
    """C cuts ``lower <= normal·x <= upper`` of a vehicle class: normal (C, n), lower and upper (C,).

    ``plane`` are the position states, in which cuts are made to be tight; ``scenario`` (C,) and ``predicate`` (C,)
    say which predicate of which scenario each cut belongs to.
    """

    normal: Floats
    lower: Floats
    upper: Floats
    plane: tuple[int, int] | None
    scenario: tuple[str, ...]
    predicate: tuple[int, ...]
    names: tuple[str, ...]

    @property
    def count(self) -> int:
        """Number of cuts C."""
        return len(self.lower)


def tangents(center: Floats, radius: float, count: int = DISC_TANGENTS) -> tuple[Floats, Floats]:
    """Half-spaces ``normal·x <= bound`` (count, 2), (count,) around a disc: tangents of ``r² - |x - q|²``, outer.

    The value and gradient come from CasADi, compiled once and evaluated at all points in one call.
    """
    x = casadi.SX.sym("x", 2)
    h = radius**2 - casadi.sumsqr(x - casadi.DM(center))
    linear = casadi.Function("linear", [x], [h, casadi.jacobian(h, x)])
    angle = 2 * np.pi * np.arange(count) / count
    points = center[:, None] + radius * np.stack([np.cos(angle), np.sin(angle)])
    values, gradients = linear.map(count)(points)
    value = np.array(values).ravel()
    gradient = np.array(gradients).reshape(count, 2)
    bound = value - (gradient * points.T).sum(axis=1)
    length = np.linalg.norm(gradient, axis=1)
    # h at a point on the border is zero up to rounding; the margin keeps the tangent outside.
    margin = 1e-12 * (1.0 + np.abs(center).sum() + radius)
    return -gradient / length[:, None], bound / length + margin


def compile_cuts(scenarios: Sequence[Scenario], profile: VehicleProfile) -> CutTable:
    """All predicates of some scenarios as cuts over the states of a profile.

    Raises ``ScenarioError`` where a scenario names a state that the profile neither has nor maps.
    """
    n = len(profile.state)
    normals: list[Floats] = []
    lowers: list[float] = []
    uppers: list[float] = []
    owner: list[tuple[str, int, str]] = []
    for scenario in scenarios:
        index = scenario.state_indices(profile)
        for number, timed in enumerate(scenario.predicates):
            rows, low, high = _cuts_of(timed.predicate, index, n)
            normals += list(rows)
            lowers += low.tolist()
            uppers += high.tolist()
            owner += [(scenario.name, number, timed.name)] * len(low)
    plane = profile.position if n >= 2 and profile.position[0] != profile.position[1] else None
    return CutTable(
        np.array(normals).reshape(-1, n), np.array(lowers), np.array(uppers), plane,
        tuple(o[0] for o in owner), tuple(o[1] for o in owner), tuple(o[2] for o in owner),
    )  # fmt: skip


def _cuts_of(
    predicate: LinearPredicate | DiscPredicate, index: Mapping[str, int], n: int
) -> tuple[Floats, Floats, Floats]:
    if isinstance(predicate, LinearPredicate):
        normal = np.zeros((1, n))
        for name, coefficient in predicate.coefficients.items():
            normal[0, index[name]] += coefficient
        return normal, np.array([predicate.lower]), np.array([predicate.upper])
    places = [index[name] for name in predicate.center]
    directions, bounds = tangents(np.array(list(predicate.center.values())), predicate.radius)
    half = len(bounds) // 2
    normal = np.zeros((half, n))
    for place, column in zip(places, directions[:half].T, strict=True):
        # A profile may map both coordinates to the same state.
        normal[:, place] += column
    # Opposite tangents are the two sides of one strip.
    return normal, -bounds[half:], bounds[:half]


def activity(
    table: CutTable, scenarios: Mapping[str, Scenario], name: str, elapsed: Ints, slack: int
) -> NDArray[np.bool_]:
    """Which cuts (..., C) of scenario ``name`` hold at the times ``elapsed`` (..., ns since its time zero)."""
    active = scenarios[name].active(elapsed, np.array(slack, dtype=np.int64))
    result = np.zeros((*elapsed.shape, table.count), dtype=bool)
    for c, (owner, predicate) in enumerate(zip(table.scenario, table.predicate, strict=True)):
        if owner == name:
            result[..., c] = active[..., predicate]
    return result
