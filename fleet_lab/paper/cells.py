"""Cells of the tables: what one way to compute sets gives along some drives."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fleet_lab.paper.cuts import CutSets, Situation, holds
from fleet_lab.paper.formulas import Formula
from reach_server.numeric.types import FloatArray
from reach_server.sets import Zonotope

NONE, NONE_RING = "none", "none_ring"
KINDS: Final = ("zonotope", "constrained")
#: The printed areas, m²: Tables I and II of [AJS+22], by formula and kind.
PRINTED: Final = {
    (NONE, "zonotope"): 9.722,
    (NONE_RING, "zonotope"): 9.722,
    ("phi_p", "zonotope"): 9.311,
    ("phi_p", "constrained"): 7.042,
    ("phi_theta", "zonotope"): 0.124,
    ("phi_theta", "constrained"): 0.076,
    ("phi_r", "zonotope"): 9.109,
    ("phi_r", "constrained"): 5.956,
}

Cut = Callable[[Zonotope, Formula, Situation, FloatArray], CutSets]


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """S steps of a drive: the sets of the next position before any cut, what formulas refer to, and where it was."""

    sets: Zonotope
    at: Situation
    truth: FloatArray

    def take(self, steps: NDArray[np.bool_]) -> "Drive":
        """Some of the steps, a mask (S,)."""
        at = Situation(self.at.t[steps], self.at.last[steps], self.at.heading[steps], self.at.unknown)
        return Drive(Zonotope(self.sets.center[steps], self.sets.generators[steps]), at, self.truth[steps])


@dataclass(frozen=True, slots=True)
class Cell:
    """Mean areas in m² over all steps of all drives.

    Attributes:
        formula, kind: key of the formula, or ``NONE`` (the lot) or ``NONE_RING``; one of ``KINDS``.
        area: None where only states are counted.
        uncut: of the same sets before any cut.
        by_drive: area of each drive.
        algorithm_2: what Algorithm 2 makes of the same sets.
        most_of_uncut, most_of_algorithm_2: the greatest area of a single set over that before any cut, and over that
            after Algorithm 2.
        outside, steps: true states outside of their set, of all that were checked.
        microseconds: median over the drives of the time for one set, its cuts and its area, in a batch of all steps.
        printed: the paper's figure, None where it gives none or it is not comparable.
        note: what to know about this cell.
    """

    formula: str
    kind: str
    area: float | None
    uncut: float | None = None
    by_drive: tuple[float, ...] = ()
    algorithm_2: float | None = None
    outside: int | None = None
    steps: int | None = None
    microseconds: float | None = None
    printed: float | None = None
    note: str = ""
    most_of_uncut: float | None = None
    most_of_algorithm_2: float | None = None

    @property
    def ratio(self) -> float | None:
        """Area over that before any cut."""
        return None if self.area is None or not self.uncut else self.area / self.uncut

    @property
    def ratio_printed(self) -> float | None:
        """Area over the printed one."""
        return None if self.area is None or not self.printed else self.area / self.printed


@dataclass(frozen=True, slots=True)
class Block:
    """Cells under a heading. ``unsound`` marks demonstrations, whose states may lie outside."""

    key: str
    title: str
    note: str
    cells: tuple[Cell, ...]
    unsound: bool = False
    extra: dict[str, Any] = field(default_factory=dict)


def uncut_cell(drives: Sequence[Drive], key: str, printed: float | None) -> Cell:
    """The sets as they are."""
    areas = [drive.sets.area() for drive in drives]
    inside = [holds(drive.sets, drive.truth) for drive in drives]
    area = _mean(areas)
    return Cell(key, "zonotope", area, area, _each(areas), None, _outside(inside), _steps(drives), None, printed)


def cut_cell(
    drives: Sequence[Drive],
    formula: Formula,
    kind: str,
    cut: Cut,
    algorithm_2: Cut | None = None,
    *,
    printed: float | None = None,
    note: str = "",
) -> Cell:
    """The sets cut by ``cut``, beside what ``algorithm_2`` makes of them."""
    found, areas, seconds = [], [], []
    # What is compiled or loaded at the first call is no part of the times.
    cut(drives[0].sets, formula, drives[0].at, drives[0].truth).sets.area()
    for drive in drives:
        began = time.perf_counter()
        found.append(cut(drive.sets, formula, drive.at, drive.truth))
        areas.append(found[-1].sets.area())
        seconds.append((time.perf_counter() - began) / len(drive.truth))
    uncut = [drive.sets.area() for drive in drives]
    other = None
    if algorithm_2 is not None:
        other = [algorithm_2(d.sets, formula, d.at, d.truth).sets.area() for d in drives]
    return Cell(
        formula.key, kind, _mean(areas), _mean(uncut), _each(areas), None if other is None else _mean(other),
        _outside([cuts.inside for cuts in found]), _steps(drives), float(np.median(seconds)) * 1e6, printed, note,
        most(areas, uncut), None if other is None else most(areas, other),
    )  # fmt: skip


def counted_cell(drives: Sequence[Drive], formula: Formula, cut: Cut, note: str) -> Cell:
    """Only how many true states lie outside: areas of wrong sets say nothing."""
    inside = [cut(drive.sets, formula, drive.at, drive.truth).inside for drive in drives]
    return Cell(formula.key, "constrained", None, outside=_outside(inside), steps=_steps(drives), note=note)


def most(areas: Sequence[Any], of: Sequence[Any]) -> float:
    """The greatest ratio of two areas of the same step."""
    return float((np.concatenate(areas) / np.concatenate(of)).max())


def _mean(areas: Sequence[Any]) -> float:
    return float(np.concatenate(areas).mean())


def _each(areas: Sequence[Any]) -> tuple[float, ...]:
    return tuple(float(np.mean(area)) for area in areas)


def _outside(inside: Sequence[Any]) -> int:
    return int(sum(np.count_nonzero(~part) for part in inside))


def _steps(drives: Sequence[Drive]) -> int:
    return sum(len(drive.truth) for drive in drives)
