"""Interval evaluation of a CasADi function: bounds of its value over whole boxes, many boxes in one call.

CasADi has no interval type, but an SX function is a tape of elementary operations; here each of them is done with the
interval of its operands. What comes out holds the value at every point of the box [Moo66].
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import casadi
import numpy as np

from fleet_bus.errors import ScenarioError
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.predicates.interval_ad import arithmetic as rules
from reach_server.predicates.interval_ad import elementary as functions
from reach_server.predicates.interval_ad.arithmetic import Bounds

Rule = Callable[..., Bounds]
Test = Callable[..., BoolArray]


@dataclass(frozen=True, slots=True)
class Operation:
    """An elementary operation: its rule, the boxes that are not wholly in its domain, and those on which it is not
    twice continuously differentiable (given its result and its operands; ``watched``: in which operands)."""

    rule: Rule
    undefined: Test | None = None
    kinked: Test | None = None
    watched: tuple[int, ...] = (0, 1)


@dataclass(frozen=True, slots=True, eq=False)
class Enclosure:
    """Bounds (nnz, R) of an output over R boxes; [inf, -inf] on empty boxes, [-inf, inf] where nothing is known.

    ``smooth`` (R,): on the whole box the output is defined, and made from the differentiated inputs by twice
    continuously differentiable operations alone but for the domains of their derivatives: where an enclosure of a
    derivative is bounded as well, that is the derivative on the whole box.
    """

    lower: FloatArray
    upper: FloatArray
    smooth: BoolArray


def _undecided(result: Bounds, *_: Bounds) -> BoolArray:
    return np.asarray(result[0] != result[1])


def _meet(_: Bounds, a: Bounds, b: Bounds) -> BoolArray:
    return np.asarray((a[1] > b[0]) & (b[1] > a[0]))


def _beyond(least: float, most: float, *, open_ended: bool = False) -> Test:
    """Test for boxes that are not within ``[least, most]``, or within ``(least, most)``; an infinite bound of a box is
    none of its numbers."""
    if open_ended:
        return lambda a: np.asarray((a[0] <= least) | ((a[1] >= most) & (most < np.inf)))
    return lambda a: np.asarray((a[0] < least) | (a[1] > most))


def _step(rule: Rule) -> Operation:
    return Operation(rule, kinked=_undecided)


_OPERATIONS: Final[dict[int, Operation]] = {
    casadi.OP_ASSIGN: Operation(rules.same),
    casadi.OP_ADD: Operation(rules.add),
    casadi.OP_SUB: Operation(rules.subtract),
    casadi.OP_MUL: Operation(rules.multiply),
    casadi.OP_DIV: Operation(rules.divide, lambda _, b: rules.holds_zero(b)),
    casadi.OP_NEG: Operation(rules.negate),
    casadi.OP_TWICE: Operation(rules.twice),
    casadi.OP_SQ: Operation(rules.square),
    casadi.OP_INV: Operation(rules.invert, rules.holds_zero),
    casadi.OP_SQRT: Operation(rules.root, _beyond(0.0, np.inf)),
    casadi.OP_POW: Operation(functions.power, functions.power_undefined),
    casadi.OP_CONSTPOW: Operation(functions.power, functions.power_undefined),
    casadi.OP_EXP: Operation(functions.rising(np.exp, 0.0, through=(0.0, 1.0))),
    casadi.OP_EXPM1: Operation(functions.rising(np.expm1, -1.0, through=(0.0, 0.0))),
    casadi.OP_LOG: Operation(functions.rising(np.log, through=(1.0, 0.0)), _beyond(0.0, np.inf, open_ended=True)),
    casadi.OP_LOG1P: Operation(functions.rising(np.log1p, through=(0.0, 0.0)), _beyond(-1.0, np.inf, open_ended=True)),
    casadi.OP_SIN: Operation(functions.sine),
    casadi.OP_COS: Operation(functions.cosine),
    casadi.OP_TAN: Operation(functions.tangent, functions.holds_pole),
    casadi.OP_ASIN: Operation(functions.rising(np.arcsin, through=(0.0, 0.0)), _beyond(-1.0, 1.0)),
    casadi.OP_ACOS: Operation(functions.arccosine, _beyond(-1.0, 1.0)),
    casadi.OP_ATAN: Operation(functions.rising(np.arctan, through=(0.0, 0.0))),
    casadi.OP_ATAN2: Operation(functions.angle, kinked=lambda _, y, x: functions.crosses_branch(y, x)),
    casadi.OP_SINH: Operation(functions.rising(np.sinh, through=(0.0, 0.0))),
    casadi.OP_COSH: Operation(functions.hyperbolic_cosine),
    casadi.OP_TANH: Operation(functions.rising(np.tanh, -1.0, 1.0, (0.0, 0.0))),
    casadi.OP_ASINH: Operation(functions.rising(np.arcsinh, through=(0.0, 0.0))),
    casadi.OP_ACOSH: Operation(functions.rising(np.arccosh, 0.0, through=(1.0, 0.0)), _beyond(1.0, np.inf)),
    casadi.OP_ATANH: Operation(functions.rising(np.arctanh, through=(0.0, 0.0)), _beyond(-1.0, 1.0, open_ended=True)),
    casadi.OP_ERF: Operation(functions.erf),
    casadi.OP_HYPOT: Operation(functions.hypotenuse),
    casadi.OP_FABS: Operation(rules.absolute, kinked=lambda _, a: np.asarray((a[0] < 0) & (a[1] > 0))),
    casadi.OP_FMIN: Operation(rules.minimum, kinked=_meet),
    casadi.OP_FMAX: Operation(rules.maximum, kinked=_meet),
    casadi.OP_FLOOR: _step(rules.floor),
    casadi.OP_CEIL: _step(rules.ceil),
    casadi.OP_SIGN: _step(rules.sign),
    casadi.OP_LT: _step(rules.less),
    casadi.OP_LE: _step(rules.less_equal),
    casadi.OP_EQ: _step(rules.equal),
    casadi.OP_NE: _step(rules.not_equal),
    casadi.OP_NOT: _step(rules.negated),
    casadi.OP_AND: _step(rules.both),
    casadi.OP_OR: _step(rules.either),
    casadi.OP_IF_ELSE_ZERO: Operation(
        rules.chosen,
        kinked=lambda _, condition, a: rules.holds_zero(condition) & _undecided(condition),
        watched=(0,),
    ),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Instruction:
    """One operation: where its operands lie and where its result goes; ``watched``: a kink would matter."""

    operation: Operation
    operands: tuple[int, ...]
    result: int
    watched: bool
    conditional: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Value:
    """Bounds, where they are not defined on the whole box and where a kink went into them; None: nowhere."""

    bounds: Bounds
    undefined: BoolArray | None = None
    kinked: BoolArray | None = None


class Tape:
    """An SX function, to be evaluated over boxes.

    ``differentiated`` are the inputs in which the outputs are to be smooth. Raises ``ScenarioError`` for an operation
    that has no interval rule.
    """

    def __init__(self, function: casadi.Function, differentiated: Collection[int] = (0,)) -> None:
        self._inputs: list[tuple[int, int, int]] = []
        self._outputs: list[tuple[int, int, int]] = []
        self._constants: list[tuple[int, float]] = []
        self._steps: list[_Instruction | tuple[str, int]] = []
        self._slots = function.sz_w()
        self._sizes = [function.nnz_out(i) for i in range(function.n_out())]
        depends = [False] * self._slots
        for index in range(function.n_instructions()):
            code = function.instruction_id(index)
            operands, results = function.instruction_input(index), function.instruction_output(index)
            if code == casadi.OP_INPUT:
                self._steps.append(("input", len(self._inputs)))
                self._inputs.append((results[0], operands[0], operands[1]))
                depends[results[0]] = operands[0] in differentiated
            elif code == casadi.OP_OUTPUT:
                self._steps.append(("output", len(self._outputs)))
                self._outputs.append((operands[0], results[0], results[1]))
            elif code == casadi.OP_CONST:
                self._steps.append(("constant", len(self._constants)))
                self._constants.append((results[0], function.instruction_constant(index)))
                depends[results[0]] = False
            else:
                self._steps.append(_instruction(code, tuple(operands), results[0], depends))
                depends[results[0]] = any(depends[o] for o in operands)

    def __call__(self, *inputs: Bounds) -> tuple[Enclosure, ...]:
        """Outputs over boxes, one ``(lower, upper)`` (nnz, R) for each input; R may be 1 for some of them."""
        rows = max((low.shape[-1] for low, _ in inputs), default=1)
        cleaned = [_clean(low, high) for low, high in inputs]
        empty = np.zeros(rows, dtype=bool)
        for low, high in inputs:
            empty = empty | (low > high).any(axis=0)
        work: list[_Value] = [_NOTHING] * self._slots
        lower = [np.full((size, rows), -np.inf) for size in self._sizes]
        upper = [np.full((size, rows), np.inf) for size in self._sizes]
        smooth = [np.ones(rows, dtype=bool) for _ in self._sizes]
        with np.errstate(all="ignore"):
            for step in self._steps:
                if isinstance(step, _Instruction):
                    work[step.result] = _applied(step, [work[o] for o in step.operands])
                    continue
                kind, number = step
                if kind == "input":
                    slot, which, entry = self._inputs[number]
                    work[slot] = _Value((cleaned[which][0][entry], cleaned[which][1][entry]))
                elif kind == "constant":
                    slot, constant = self._constants[number]
                    work[slot] = _Value((np.array([constant]), np.array([constant])))
                else:
                    slot, which, entry = self._outputs[number]
                    value = work[slot]
                    lower[which][entry], upper[which][entry] = _known(value)
                    for flaw in (value.undefined, value.kinked):
                        if flaw is not None:
                            smooth[which] &= ~flaw
        if empty.any():
            for low, high in zip(lower, upper, strict=True):
                low[:, empty], high[:, empty] = np.inf, -np.inf
        return tuple(map(Enclosure, lower, upper, smooth))


_NOTHING = _Value((np.array([-np.inf]), np.array([np.inf])))


def _instruction(code: int, operands: Sequence[int], result: int, depends: Sequence[bool]) -> _Instruction:
    operation = _OPERATIONS.get(code)
    if operation is None:
        raise ScenarioError(f"the operation {_name(code)} cannot be bounded over a set of states: use another one")
    if code == casadi.OP_MUL and operands[0] == operands[1]:
        operation, operands = _OPERATIONS[casadi.OP_SQ], operands[:1]
    watched = operation.kinked is not None and any(
        depends[o] for index, o in enumerate(operands) if index in operation.watched
    )
    return _Instruction(operation, tuple(operands), result, watched, code == casadi.OP_IF_ELSE_ZERO)


def _name(code: int) -> str:
    return next((name for name in dir(casadi) if name.startswith("OP_") and getattr(casadi, name) == code), str(code))


def _applied(step: _Instruction, operands: list[_Value]) -> _Value:
    bounds = [o.bounds for o in operands]
    low, high = step.operation.rule(*bounds)
    undefined = _any(operand.undefined for operand in operands)
    kinked = _any(operand.kinked for operand in operands)
    if step.conditional:
        # What is not chosen need not be defined, nor smooth.
        condition, value = operands
        passed = ~((condition.bounds[0] == 0) & (condition.bounds[1] == 0))
        undefined = _any((condition.undefined, None if value.undefined is None else value.undefined & passed))
        kinked = _any((condition.kinked, None if value.kinked is None else value.kinked & passed))
    if step.operation.undefined is not None:
        outside = step.operation.undefined(*bounds)
        undefined = _any((undefined, outside if outside.any() else None))
    if step.watched and step.operation.kinked is not None:
        kinks = step.operation.kinked((low, high), *bounds)
        kinked = _any((kinked, kinks if kinks.any() else None))
    if undefined is not None:
        low, high = np.where(undefined, -np.inf, low), np.where(undefined, np.inf, high)
    return _Value((low, high), undefined, kinked)


def _any(masks: Iterable[BoolArray | None]) -> BoolArray | None:
    found: BoolArray | None = None
    for mask in masks:
        if mask is not None:
            found = mask if found is None else found | mask
    return found


def _known(value: _Value) -> Bounds:
    """Bounds with nothing known in place of NaN, which no rule should give."""
    low, high = value.bounds
    return np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)


def _clean(low: FloatArray, high: FloatArray) -> Bounds:
    """Bounds of numbers: nothing known where they are NaN or cross."""
    unknown = ~(low <= high)
    most = np.finfo(np.float64).max
    return np.where(unknown, -np.inf, np.minimum(low, most)), np.where(unknown, np.inf, np.maximum(high, -most))


_CODES: Final = {id(operation): code for code, operation in _OPERATIONS.items()}


def code_of(operation: Operation) -> int:
    """Number of an operation of tapes, by which ``operation_of`` finds it again; raises ``KeyError`` for another."""
    return _CODES[id(operation)]


def operation_of(code: int) -> Operation:
    """The operation of a number; raises ``KeyError`` where there is none."""
    return _OPERATIONS[code]
