"""A formula of this version's fragment to what it comes to: predicates that hold on windows of time."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final

from side_info.expression import number_text
from side_info.formula import Always, And, Comparison, Formula, Region, window_ns
from side_info.normal_form import normal_form
from side_info.places import Excerpt
from side_info.predicates import Predicate

#: Predicates that one formula may come to.
MAX_PREDICATES: Final = 256

_NAME_LENGTH: Final = 80

Regions = Mapping[str, tuple[Predicate, ...]]


@dataclass(frozen=True, slots=True)
class TimedPredicate:
    """``predicate`` holds from ``start_ns`` to ``end_ns`` after time zero, both included (whole nanoseconds).

    ``name`` is unique in its scenario.
    """

    name: str
    predicate: Predicate
    start_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True)
class _Piece:
    predicate: Predicate
    window: str
    start_ns: int
    end_ns: int


def timeless_predicates(formula: Formula, regions: Regions, excerpt: Excerpt) -> tuple[Predicate, ...]:
    """Predicates that together mean a formula without ``always``; raise ``ScenarioError`` if it has one."""
    match formula:
        case Region(name):
            return regions[name]
        case Comparison():
            return normal_form(formula, excerpt)
        case And(operands):
            predicates: tuple[Predicate, ...] = ()
            for operand in operands:
                predicates += timeless_predicates(operand, regions, excerpt)
                _check_count(len(predicates), operand, excerpt)
            return predicates
    raise excerpt.error(formula.at, "'always' has no meaning here: a region does not change in time")


def timed_predicates(formula: Formula, regions: Regions, excerpt: Excerpt) -> tuple[TimedPredicate, ...]:
    """Predicates on windows that together mean the formula, in its order; exact but for the closure of ``<``.

    Raises ``ScenarioError`` for an atom outside of ``always``.
    """
    pieces: list[_Piece] = []
    for piece in _pieces(formula, regions, excerpt):
        # The same predicate, said twice for the same time, is one.
        if piece not in pieces:
            pieces.append(piece)
            _check_count(len(pieces), formula, excerpt)
    names = _unique_names(pieces)
    return tuple(
        TimedPredicate(name, replace(piece.predicate, name=name), piece.start_ns, piece.end_ns)
        for name, piece in zip(names, pieces, strict=True)
    )


def _pieces(formula: Formula, regions: Regions, excerpt: Excerpt) -> Iterable[_Piece]:
    match formula:
        case And(operands):
            for operand in operands:
                yield from _pieces(operand, regions, excerpt)
        case Always():
            window = f"[{number_text(formula.start)}:{number_text(formula.end)}]"
            start_ns, end_ns = window_ns(formula.start, formula.end)
            for predicate in timeless_predicates(formula.operand, regions, excerpt):
                yield _Piece(predicate, window, start_ns, end_ns)
        case _:
            raise excerpt.error(
                formula.at,
                f"'{formula!s:.40}' stands outside of 'always[a:b](…)', not supported in this version",
            )


def _check_count(count: int, formula: Formula, excerpt: Excerpt) -> None:
    """Regions made of regions made of regions could come to any number of predicates."""
    if count > MAX_PREDICATES:
        raise excerpt.error(formula.at, f"more than {MAX_PREDICATES} predicates: expected fewer")


def _unique_names(pieces: list[_Piece]) -> list[str]:
    """Names of the predicates; one active on several windows has them in its name."""
    short = [_shortened(piece.predicate.name) for piece in pieces]
    windows: dict[str, set[str]] = {name: set() for name in short}
    for name, piece in zip(short, pieces, strict=True):
        windows[name].add(piece.window)
    windowed = [
        name if len(windows[name]) == 1 else name + piece.window for name, piece in zip(short, pieces, strict=True)
    ]
    return [
        name if windowed.count(name) == 1 else f"{name}#{windowed[: index + 1].count(name)}"
        for index, name in enumerate(windowed)
    ]


def _shortened(name: str) -> str:
    return name if len(name) <= _NAME_LENGTH else name[: _NAME_LENGTH - 1] + "…"
