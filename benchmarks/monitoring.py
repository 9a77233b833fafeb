"""Formulas followed sample by sample: obligations of a fleet, and RTAMT's online monitor."""

import logging
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks import traces
from benchmarks.plots import bars
from benchmarks.report import Cell, Claim, Table
from benchmarks.timing import spread, swept
from benchmarks.traces import Traces
from reach_server.numeric.types import FloatArray
from reach_server.side_information.tracker import ASSUME, ScenarioTracker
from side_info.progression import DEAD, TRUE
from side_info.progression import Table as Obligations
from side_info.stl.nnf import Conjunction, Disjunction, Finally, Globally, Literal, Normal, Until, reach_ns

with warnings.catch_warnings():
    # Its parser's runtime imports from a module that Python is about to drop.
    warnings.simplefilter("ignore", DeprecationWarning)
    import rtamt


OURS, THEIRS = "obligations", "RTAMT, online"
FAILS = "its negation"
FLEET = 1000
#: A sample every 0.1 s; in a quick run every 0.5 s.
STEP_NS, QUICK_STEP_NS = 100_000_000, 500_000_000
#: Samples that RTAMT is timed on with the whole fleet, which would take it too long for all.
FEW = 3


@dataclass(frozen=True, slots=True)
class Task:
    """A formula, its negation where that is followed, too, and the drives."""

    name: str
    holds: Normal
    fails: Normal | None
    drives: Traces

    @property
    def true(self) -> NDArray[np.bool_]:
        """Predicates that hold (V, K, P), at as many samples as the formula reaches over."""
        return self.drives.true[:, : reach_ns(self.holds) // self.drives.step_ns + 1]


def run(quick: bool) -> Table:
    """Microseconds a sample and vehicle, and how many final verdicts agree."""
    vehicles, compared, step_ns = (8, 4, QUICK_STEP_NS) if quick else (FLEET, 12, STEP_NS)
    rows: list[tuple[Cell, ...]] = []
    claims: list[Claim] = []
    differ = both = total = 0
    for task in tasks(vehicles, step_ns):
        with swept():
            fleet, verdicts = follow(task, np.arange(vehicles))
        chosen = _of_each(verdicts, compared)
        with swept():
            alone, _ = follow(task, chosen[:1])
        monitors = [Monitor(task.holds, step_ns) for _ in range(vehicles)]
        theirs, robust = [], []
        with swept():
            for monitor, vehicle in zip(monitors, chosen, strict=False):
                seconds, robustness = monitor.follow(task.true[vehicle])
                theirs.append(seconds)
                robust.append(robustness > 0)
            together = _round(monitors, task.true)
        differ += int((verdicts[chosen] != np.where(robust, 1, -1)).sum())
        both += int(0 < sum(robust) < len(robust))
        total += len(robust)
        unlike = different(task.true[..., monitors[0].predicates])
        for number, mine, peer, drives in (
            (1, alone, theirs[0], 1), (vehicles, fleet / vehicles, together / vehicles, unlike),
        ):  # fmt: skip
            ratio = float(np.median(peer) / np.median(mine))
            for method, found, times in ((OURS, mine, 1.0), (THEIRS, peer, ratio)):
                rows.append((
                    task.name, number, method, *spread(found, 1e6), float(found.max()) * 1e6, times, drives,
                    f"{sum(robust)} of {len(robust)}",
                ))  # fmt: skip
        if not quick:
            claims.append(Claim(f"{task.name}, {vehicles} vehicles: RTAMT's time over ours", ratio, "≥", 1.0))
    return Table(
        "Formulas followed sample by sample",
        f"Formulas of the shipped scenarios, a sample every {step_ns / 1e9:g} s; which predicates hold is computed "
        "beforehand for both. RTAMT (discrete time, `pastify`, then `update` at every sample, one object a vehicle, "
        "made beforehand) gives the robustness of the formula at each start, once its horizon is over. Ours follows "
        "each vehicle from its time zero, in one table for the fleet: after each sample it knows what the formula "
        "still asks, which predicates cut next, and a verdict as soon as it is certain; of a requirement it follows "
        "the negation, too. So the two answer different questions; only the final verdicts are the same, and are "
        "compared. The table of obligations is empty at the first sample: what is learnt about one vehicle counts "
        "for all, and for one vehicle alone all is new. Many drives of a fleet are the same to a formula: 'different' "
        "counts those whose predicates in it do not hold at the very same samples. Our table profits from equal "
        f"drives, RTAMT's monitors do not. RTAMT with the fleet is timed over its first {FEW} samples only, ours over "
        "all. It is given signals instead of predicates, and each occurrence has one of its own: RTAMT 0.4.10 delays "
        "predicates twice when it is made to look back, and keeps one buffer for equal subformulas but fills it for "
        "each. 'True': drives that satisfy the formula, of those compared.",
        (
            "formula", "vehicles", "method", "µs a sample and vehicle", "25 %", "75 %", "longest", "times ours",
            "different", "true",
        ),
        rows,
        [
            Claim("final verdicts that differ from RTAMT's", float(differ), "≤", 0.0),
            Claim("final verdicts compared with RTAMT's", float(total), "≥", 20.0 if quick else 60.0),
            Claim("formulas compared on drives of either kind", float(both), "≥", 3.0 if quick else 5.0),
            *claims,
        ],
        keys=3,
    )  # fmt: skip


def plot(table: Table) -> Figure:
    """Both sides, by formula and number of vehicles."""
    return bars(
        table,
        lambda row: f"{row[0]}, {row[1]} vehicle{'' if row[1] == 1 else 's'}",
        lambda row: str(row[2]),
        3,
        "µs a sample and vehicle",
    )


def tasks(vehicles: int, step_ns: int) -> Iterator[Task]:
    """What is followed."""
    for drives in (traces.parking_lot(vehicles, step_ns), traces.convoy(vehicles, step_ns)):
        scenario = drives.scenario
        yield Task(f"{scenario.name}: assume", scenario.side_information, None, drives)
        for name, requirement in scenario.requirements.items():
            if name != "keeps_moving":
                yield Task(f"{scenario.name}: {name}", requirement.holds, requirement.fails, drives)


def follow(task: Task, vehicles: NDArray[np.intp]) -> tuple[FloatArray, NDArray[np.int64]]:
    """Seconds of each sample (K,) of all vehicles together, and their verdicts (V,): 1, -1, or 0 if open."""
    table = Obligations()
    formulas = {ASSUME: task.holds} | ({} if task.fails is None else {FAILS: task.fails})

    def root(formula: Normal) -> Any:
        return lambda grid, lead: table.add(formula, grid, lambda predicate, margin: predicate, lead=lead)

    step_ns = task.drives.step_ns
    tracker = ScenarioTracker(
        task.drives.scenario, table, step_ns, 0, {name: root(formula) for name, formula in formulas.items()}
    )
    slots = np.arange(len(vehicles))
    for slot in slots.tolist():
        tracker.assign(slot, step_ns, 0)
    status = np.where(task.true[vehicles], 1, -1).astype(np.int8)
    seconds = np.zeros(status.shape[1])
    for k in range(len(seconds)):
        t = np.full(len(slots), (k + 1) * step_ns)
        now = status[:, k]
        began = time.perf_counter()
        tracker.observe(slots, t, lambda literals, rows, now=now: now[rows][:, literals])  # type: ignore[misc]
        seconds[k] = time.perf_counter() - began
    last = tracker.formula_states[ASSUME].after[slots]
    return seconds, np.where(last == DEAD, -1, np.where(last == table.belief([TRUE]), 1, 0))


class Monitor:
    """RTAMT's online monitor of one vehicle."""

    def __init__(self, formula: Normal, step_ns: int) -> None:
        self._step = step_ns
        self.predicates: list[int] = []
        text = self._text(formula, count())
        self._specification: Any = rtamt.StlDiscreteTimeSpecification()
        self._names = [f"s{i}" for i in range(len(self.predicates))]
        for name in self._names:
            self._specification.declare_var(name, "float")
        self._specification.spec = text
        with _quiet():
            self._specification.parse()
            self._specification.pastify()

    def _text(self, formula: Normal, number: Iterator[int]) -> str:
        """The formula in RTAMT's words, windows in samples; its until does not ask the left of the witness."""

        def window(start_ns: int, end_ns: int) -> str:
            return f"[{-(-start_ns // self._step)}:{end_ns // self._step}]"

        match formula:
            case Literal(predicate):
                self.predicates.append(predicate)
                return f"s{next(number)}"
            case Conjunction(operands):
                return "(" + " and ".join(self._text(operand, number) for operand in operands) + ")"
            case Disjunction(operands):
                return "(" + " or ".join(self._text(operand, number) for operand in operands) + ")"
            case Globally(start, end, operand):
                return f"(always{window(start, end)} {self._text(operand, number)})"
            case Finally(start, end, operand):
                return f"(eventually{window(start, end)} {self._text(operand, number)})"
            case Until(start, end, left, right):
                before = self._text(left, number)
                witness = f"({self._text(right, number)} and {self._text(left, number)})"
                return f"({before} until{window(start, end)} {witness})"
        raise TypeError(formula)

    def inputs(self, true: NDArray[np.bool_]) -> list[list[tuple[str, float]]]:
        """What ``update`` takes at each sample, from which predicates hold (K, P)."""
        values = np.where(true[:, self.predicates], 1.0, -1.0).tolist()
        return [list(zip(self._names, sample, strict=True)) for sample in values]

    def update(self, k: int, inputs: list[tuple[str, float]]) -> float:
        """Robustness as of one horizon ago."""
        return float(self._specification.update(k, inputs))

    def follow(self, true: NDArray[np.bool_]) -> tuple[FloatArray, float]:
        """Seconds of each sample (K,), and the robustness at the first one; ``true`` (K, P) reaches its horizon."""
        seconds = np.zeros(len(true))
        robustness = float("nan")
        for k, sample in enumerate(self.inputs(true)):
            began = time.perf_counter()
            robustness = self.update(k, sample)
            seconds[k] = time.perf_counter() - began
        return seconds, robustness


def _round(monitors: list[Monitor], true: NDArray[np.bool_]) -> FloatArray:
    """Seconds of a few samples, each of all vehicles, one after the other."""
    inputs = [monitor.inputs(own[:FEW]) for monitor, own in zip(monitors, true, strict=True)]
    seconds = np.zeros(FEW)
    for k in range(FEW):
        began = time.perf_counter()
        for monitor, own in zip(monitors, inputs, strict=True):
            monitor.update(k, own[k])
        seconds[k] = time.perf_counter() - began
    return seconds


def different(true: NDArray[np.bool_]) -> int:
    """Number of vehicles whose predicates (V, K, P) differ from those of all before at some sample."""
    return len(np.unique(np.packbits(true.reshape(len(true), -1), axis=1), axis=0))


def _of_each(verdicts: NDArray[np.int64], most: int) -> NDArray[np.intp]:
    """Vehicles that satisfy the formula and vehicles that violate it, in turn."""
    good, bad = np.flatnonzero(verdicts > 0), np.flatnonzero(verdicts <= 0)
    half = most // 2
    return np.concatenate([good[: max(half, most - len(bad))], bad[: max(half, most - len(good))]])


@contextmanager
def _quiet() -> Iterator[None]:
    """RTAMT warns that its output was not declared."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(before)
