"""Branches of the syntax tree to expressions."""

import math

from lark import Token

from fleet_bus.errors import ScenarioError
from side_info.documents.hints import close, word_or_function
from side_info.documents.source_location import Excerpt
from side_info.stl.declarations import Declarations
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
from side_info.stl.parser import Branch, start_of


def build_expression(branch: Branch, excerpt: Excerpt, declared: Declarations) -> Expression:
    """Expression of a branch of the syntax tree; raise ``ScenarioError`` if it is none over ``declared``."""
    at = start_of(branch)
    if isinstance(branch, Token):
        return _number(branch, excerpt) if branch.type == "NUMBER" else _name(branch, excerpt, declared)
    if branch.data == "call":
        return _call(branch.children, excerpt, declared)
    if branch.data not in ("sum", "product", "negation", "reciprocal", "power"):
        raise excerpt.error(at, "a number is expected, a formula came")
    operands = tuple(build_expression(child, excerpt, declared) for child in branch.children)
    match branch.data:
        case "sum":
            return Sum(operands, at=at)
        case "product":
            return Product(operands, at=at)
        case "negation":
            return Negation(*operands, at=at)
        case "reciprocal":
            return Reciprocal(*operands, at=at)
        case _:
            return Power(*operands, at=at)


def read_number(token: Token, excerpt: Excerpt) -> float:
    """Value of a number; raise ``ScenarioError`` if it is not finite or too small to be told from zero."""
    value = float(token)
    if math.isinf(value) or (value == 0.0 and token.lower().split("e")[0].strip("0.")):
        raise excerpt.error(start_of(token), f"{token:.40} is not a number of double precision: expected a finite one")
    return value


def undeclared(token: Token, excerpt: Excerpt, declared: Declarations) -> ScenarioError:
    """Error about a name that is not declared."""
    names = (*declared.states, *declared.regions, *declared.parameters)
    problem = f"{token[:40]!r} is not declared: declared are {declared.describe()}{close(token, names)}"
    return excerpt.error(start_of(token), problem)


def _number(token: Token, excerpt: Excerpt) -> Number:
    return Number(read_number(token, excerpt), at=start_of(token))


def _name(token: Token, excerpt: Excerpt, declared: Declarations) -> Expression:
    at = start_of(token)
    if token == "t":
        return Time(at=at)
    if token == "k":
        return Steps(at=at)
    if token in declared.states:
        return Name(str(token), at=at)
    if token in declared.parameters:
        value = declared.parameters[token]
        number = Number(abs(value), at=at)
        return Negation(number, at=at) if value < 0 else number
    if token in declared.regions:
        raise excerpt.error(at, f"a number is expected, {str(token)!r} is a region")
    raise undeclared(token, excerpt, declared)


def _call(children: list[Branch], excerpt: Excerpt, declared: Declarations) -> Expression:
    function, *arguments = children
    at = start_of(function)
    if function == "last":
        return _last(arguments, excerpt, declared, at)
    if function == "in":
        raise excerpt.error(at, "a number is expected, in(…) is a formula")
    if function not in FUNCTIONS:
        problem = f"unknown function {str(function)[:40]!r}: expected one of {', '.join(FUNCTIONS)}"
        raise excerpt.error(at, problem + word_or_function(str(function), FUNCTIONS))
    least, most = FUNCTIONS[str(function)].least, FUNCTIONS[str(function)].most
    if not least <= len(arguments) <= (most or len(arguments)):
        wrong = start_of(arguments[least]) if len(arguments) > least else at
        expected = "one argument" if least == 1 else "two arguments"
        raise excerpt.error(wrong, f"{function} takes {expected}, {len(arguments)} came")
    built = tuple(build_expression(argument, excerpt, declared) for argument in arguments)
    return Call(str(function), built, at=at)


def _last(arguments: list[Branch], excerpt: Excerpt, declared: Declarations, at: int) -> Last:
    state = arguments[0]
    if len(arguments) != 1 or not isinstance(state, Token) or state.type == "NUMBER":
        raise excerpt.error(start_of(arguments[-1]), "last(…) takes the name of one state, or t")
    if state in declared.regions or state in declared.parameters or state == "k":
        raise excerpt.error(start_of(state), f"last(…) takes the name of one state, or t: {str(state)!r} is neither")
    if state != "t" and state not in declared.states:
        raise undeclared(state, excerpt, declared)
    return Last(str(state), at=at)
