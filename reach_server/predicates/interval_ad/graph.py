"""Expressions of the scenario language as CasADi graphs: what they depend on, and where they are defined."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import reduce
from typing import Final, Literal

import casadi
import numpy as np

from fleet_bus.errors import ScenarioError
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
from side_info.stl.functions import FUNCTIONS, Demand

#: Quantities of the context: time, steps ahead, time of the last received sample, or a state at it by its place.
Given = Literal["t", "k", "last t"] | int

#: The greatest exponent that is multiplied out.
_MOST_FACTORS: Final = 64


@dataclass(frozen=True, slots=True, eq=False)
class Symbolic:
    """``value`` over symbols: ``states`` at ``coordinates`` of the state vector, ``constants`` with ``numbers``, and
    ``context`` symbols that stand for ``given``.

    The numbers of the expression are symbols, too: so CasADi never rounds one while it simplifies, and what is left to
    do is done in interval arithmetic. Its value is defined where every one of ``domain`` is what is demanded of it.
    """

    value: casadi.SX
    states: casadi.SX
    coordinates: tuple[int, ...]
    constants: casadi.SX
    numbers: tuple[float, ...]
    context: casadi.SX
    given: tuple[Given, ...]
    domain: tuple[tuple[casadi.SX, Demand], ...]


def symbolic(expression: Expression, index: Mapping[str, int]) -> Symbolic:
    """An expression over the states at the places that ``index`` gives.

    Raises ``ScenarioError`` for a name without a place and for a function that is not known.
    """
    writer = _Writer(index)
    value = writer.write(expression)

    return Symbolic(
        casadi.SX(value),
        _stacked(writer.states.values()),
        tuple(writer.states),
        _stacked(writer.numbers.values()),
        tuple(writer.numbers),
        _stacked(writer.given.values()),
        tuple(writer.given),
        tuple(writer.domain),
    )


@dataclass(slots=True, eq=False)
class _Writer:
    index: Mapping[str, int]
    states: dict[int, casadi.SX] = field(default_factory=dict)
    numbers: dict[float, casadi.SX] = field(default_factory=dict)
    given: dict[Given, casadi.SX] = field(default_factory=dict)
    domain: list[tuple[casadi.SX, Demand]] = field(default_factory=list)

    def write(self, expression: Expression) -> casadi.SX:
        match expression:
            case Number(value):
                return self.numbers.setdefault(value, casadi.SX.sym(f"c{len(self.numbers)}"))
            case Name(name):
                return self.states.setdefault(self._place(name), casadi.SX.sym(name))
            case Time():
                return self._given("t")
            case Steps():
                return self._given("k")
            case Last("t"):
                return self._given("last t")
            case Last(name):
                return self._given(self._place(name))
            case Sum(terms):
                return reduce(self._plus, terms[1:], self.write(terms[0]))
            case Product(factors):
                return reduce(self._times, factors[1:], self.write(factors[0]))
            case Negation(operand):
                return -self.write(operand)
            case Reciprocal(operand):
                return 1 / self._demanded(self.write(operand), "nonzero")
            case Power(base, exponent):
                return self._power(self.write(base), exponent)
            case Call(function, arguments):
                return self._call(function, [self.write(argument) for argument in arguments])
        raise ScenarioError(f"{expression} cannot be compiled: it is a {type(expression).__name__}")

    def _place(self, name: str) -> int:
        if name not in self.index:
            raise ScenarioError(
                f"the state {name!r} has no place in the state vector: {', '.join(self.index)} have one"
            )
        return self.index[name]

    def _given(self, what: Given) -> casadi.SX:
        return self.given.setdefault(what, casadi.SX.sym(f"g{len(self.given)}"))

    def _demanded(self, operand: casadi.SX, demand: Demand) -> casadi.SX:
        self.domain.append((operand, demand))
        return operand

    def _plus(self, total: casadi.SX, term: Expression) -> casadi.SX:
        if isinstance(term, Negation):
            return total - self.write(term.operand)
        return total + self.write(term)

    def _times(self, product: casadi.SX, factor: Expression) -> casadi.SX:
        if isinstance(factor, Reciprocal):
            return product / self._demanded(self.write(factor.operand), "nonzero")
        return product * self.write(factor)

    def _power(self, base: casadi.SX, exponent: Expression) -> casadi.SX:
        whole = _whole(exponent)
        if whole is not None:
            # 0 to the 0 is 1, as everywhere in computing.
            return base**whole if whole >= 0 else 1 / self._demanded(base, "nonzero") ** -whole
        if exponent == Number(0.5):
            return casadi.sqrt(self._demanded(base, "nonnegative"))
        demand: Demand = "nonnegative" if isinstance(exponent, Number) else "positive"
        return self._demanded(base, demand) ** self.write(exponent)

    def _call(self, name: str, arguments: list[casadi.SX]) -> casadi.SX:
        function = FUNCTIONS.get(name)
        if function is None or not function.least <= len(arguments) <= (function.most or len(arguments)):
            raise ScenarioError(f"the function {name} of {len(arguments)} arguments cannot be compiled")
        if function.needs is not None:
            demand, operand = function.needs
            self._demanded(operand(casadi, *arguments), demand)
        return casadi.SX(function.graph(casadi, *arguments))


def _stacked(symbols: Collection[casadi.SX]) -> casadi.SX:
    return casadi.vertcat(*symbols) if symbols else casadi.SX(0, 1)


def _whole(exponent: Expression) -> int | None:
    """The exponent, if it is a small whole number."""
    value = exponent.operand if isinstance(exponent, Negation) else exponent
    if not isinstance(value, Number) or value.value != np.floor(value.value) or value.value > _MOST_FACTORS:
        return None
    return -int(value.value) if isinstance(exponent, Negation) else int(value.value)
