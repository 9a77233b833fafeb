"""Where the regions of a scenario hold, on a raster over the plane of its first two states."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Final

import numpy as np

from reach_server.numeric.types import FloatArray
from side_info.documents.scenario import Scenario
from side_info.stl.expression import (
    Call,
    Expression,
    Last,
    Name,
    Negation,
    Number,
    Power,
    Product,
    Reciprocal,
    Steps,
    Sum,
    Time,
)
from side_info.stl.functions import FUNCTIONS
from side_info.stl.nnf import Conjunction, Constant, Disjunction, Literal, Normal
from side_info.stl.normal_form import literals_in
from side_info.stl.predicates import DiscPredicate, LinearPredicate, Predicate

#: Points of the raster in each direction.
POINTS: Final = 601

#: Half width of the plane where nothing bounds it, in the unit of the state.
_DEFAULT_REACH: Final = 5.0

#: Part of the regions' extent that is shown around them, and on a side to which one is open.
_MARGIN: Final = 0.12
_OPEN_MARGIN: Final = 0.5

#: The shorter side of the plane is at least this part of the longer one.
_LEAST_ASPECT: Final = 0.7

#: A margin in place of an infinite one, which a contour would leave out.
_FAR: Final = 1e9


@dataclass(frozen=True, slots=True)
class Plane:
    """The raster: ``names`` of its two states, ``x`` and ``y`` (N,) along them in their units."""

    names: tuple[str, str]
    x: FloatArray
    y: FloatArray


@dataclass(frozen=True, slots=True)
class Drawn:
    """A region's ``margin`` (N, N), rows along y: it holds where that is at least 0."""

    name: str
    margin: FloatArray


def lay_out(scenario: Scenario) -> tuple[Plane | None, tuple[Drawn, ...], dict[str, str]]:
    """Raster around the regions of ``scenario``, those that can be drawn, and why each other one cannot (by name).

    No plane comes back if the scenario has fewer than two states. Of what is not bounded, a part is shown.
    """
    states = tuple(scenario.state)
    if len(states) < 2:
        return None, (), dict.fromkeys(scenario.regions, "there is one state only")
    names = states[0], states[1]
    left_out = {}
    for name, region in scenario.regions.items():
        reason = _why_not(region, scenario, names)
        if reason:
            left_out[name] = reason
    shown = {name: region for name, region in scenario.regions.items() if name not in left_out}
    asked = [scenario.predicates[index] for region in shown.values() for index in sorted(set(literals_in(region)))]
    plane = _plane(names, asked)
    grid = dict(zip(names, np.meshgrid(plane.x, plane.y), strict=True))
    drawn = (Drawn(name, _margin(region, scenario.predicates, grid)) for name, region in shown.items())
    return plane, tuple(drawn), left_out


def _why_not(region: Normal, scenario: Scenario, names: tuple[str, str]) -> str:
    for index in sorted(set(literals_in(region))):
        predicate = scenario.predicates[index]
        others = [state for state in predicate.states if state not in names]
        if others:
            return f"it speaks about {', '.join(others)}"
        if not isinstance(predicate, LinearPredicate | DiscPredicate):
            moving = _moving(predicate.expression)
            if moving:
                return f"it moves with {moving}"
    return ""


def _moving(expression: Expression) -> str:
    """What of an expression is no state and no number, as it is written; empty if there is nothing."""
    match expression:
        case Last() | Time() | Steps():
            return str(expression)
        case Sum(parts) | Product(parts) | Call(_, parts):
            return next(filter(None, map(_moving, parts)), "")
        case Negation(operand) | Reciprocal(operand):
            return _moving(operand)
        case Power(base, exponent):
            return _moving(base) or _moving(exponent)
    return ""


def _plane(names: tuple[str, str], predicates: list[Predicate]) -> Plane:
    lows: dict[str, list[float]] = {name: [] for name in names}
    highs: dict[str, list[float]] = {name: [] for name in names}
    for predicate in predicates:
        for name, (low, high) in _extent(predicate).items():
            lows[name].append(low)
            highs[name].append(high)
    found = {name: [v for v in (*lows[name], *highs[name]) if np.isfinite(v)] for name in names}
    widths = [max(values) - min(values) for values in found.values() if values]
    least = _LEAST_ASPECT * max(widths, default=0.0) or 2 * _DEFAULT_REACH
    axes = []
    for name in names:
        low, high = (min(found[name]), max(found[name])) if found[name] else (0.0, 0.0)
        missing = max(least - (high - low), 0.0) / 2
        margin = high - low + 2 * missing
        below = _OPEN_MARGIN if -np.inf in lows[name] else _MARGIN
        above = _OPEN_MARGIN if np.inf in highs[name] else _MARGIN
        axes.append(np.linspace(low - missing - below * margin, high + missing + above * margin, POINTS))
    return Plane(names, axes[0], axes[1])


def _extent(predicate: Predicate) -> Mapping[str, tuple[float, float]]:
    """Bounds of single states that a predicate gives."""
    match predicate:
        case DiscPredicate(_, center, radius):
            return {name: (value - radius, value + radius) for name, value in center.items()}
        case LinearPredicate(_, coefficients, lower, upper) if len(coefficients) == 1:
            ((name, factor),) = coefficients.items()
            low, high = sorted((lower / factor, upper / factor))
            return {name: (low, high)}
    return {}


def _margin(formula: Normal, predicates: tuple[Predicate, ...], grid: Mapping[str, FloatArray]) -> FloatArray:
    shape = next(iter(grid.values())).shape
    match formula:
        case Constant(value):
            return np.full(shape, 1.0 if value else -1.0)
        case Literal(index):
            return _predicate_margin(predicates[index], grid)
        case Conjunction(operands):
            return reduce(np.minimum, (_margin(operand, predicates, grid) for operand in operands))
        case Disjunction(operands):
            return reduce(np.maximum, (_margin(operand, predicates, grid) for operand in operands))
    raise TypeError(f"a region has no {type(formula).__name__}")


def _predicate_margin(predicate: Predicate, grid: Mapping[str, FloatArray]) -> FloatArray:
    match predicate:
        case LinearPredicate(_, coefficients, lower, upper):
            value = np.sum([factor * grid[name] for name, factor in coefficients.items()], axis=0)
            return np.asarray(np.minimum(value - lower, upper - value))
        case DiscPredicate(_, center, radius):
            return np.asarray(radius - np.hypot(*(grid[name] - value for name, value in center.items())))
    with np.errstate(all="ignore"):
        value = np.broadcast_to(_value(predicate.expression, grid), next(iter(grid.values())).shape)
    # Where the expression is not defined, the predicate says nothing.
    return np.asarray(np.nan_to_num(value, nan=_FAR, posinf=_FAR, neginf=-_FAR))


def _value(expression: Expression, grid: Mapping[str, FloatArray]) -> FloatArray:
    match expression:
        case Number(value):
            return np.asarray(value)
        case Name(name):
            return grid[name]
        case Sum(terms):
            return sum((_value(term, grid) for term in terms[1:]), _value(terms[0], grid))
        case Product(factors):
            return reduce(np.multiply, (_value(factor, grid) for factor in factors))
        case Negation(operand):
            return -_value(operand, grid)
        case Reciprocal(operand):
            return 1 / _value(operand, grid)
        case Power(base, exponent):
            return np.power(_value(base, grid), _value(exponent, grid))
        case Call(function, arguments):
            return np.asarray(FUNCTIONS[function].array(*(_value(argument, grid) for argument in arguments)))
    raise TypeError(f"{expression} has no value in the plane")
