"""The suite: every benchmark after the other, and a report that is whole after each of them."""

import time
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Final

from benchmarks.conditions import conditions
from benchmarks.report import Outcome, Report, Table
from fleet_lab.interruption import Interruption

#: Names of the benchmarks, each a module of this package, and what they ask.
BENCHMARKS: Final = {
    "updates": "one update of 1 to 1000 vehicles, beside the published form",
    "curves": "an update over window, horizon, vehicles, predicates, dimension",
    "vehicles": "tubes of 1000 vehicles: one batch, or one call each",
    "wire": "decoding states: a batch, or one by one",
    "containment": "true states outside of guaranteed sets, and how tight these are",
    "recordings": "coverage and area on recordings of real cars, beside the paper's method",
    "audit": "false alarms of the audit, on simulated records",
    "support": "support of constrained zonotopes, beside ZonoOpt and HiGHS",
    "outline": "planar outlines, beside ZonoOpt",
    "constraints": "fewer constraints, beside ZonoOpt",
    "strips": "zonotope and strip, beside the paper's Algorithm 2",
    "disc": "a set cut by a disc, beside the paper's strip",
    "growth": "set operations over generators, constraints, dimension, batch",
    "monitoring": "formulas sample by sample, beside RTAMT",
    "progression": "tables of obligations, and cuts by predicates",
    "encodings": "the parking lot's formula, and the paper's encoding of it",
}
#: Packages of the extra `bench`: where one is not installed, what needs it is not run.
EXTRA: Final = ("casadi", "highspy", "lark", "matplotlib", "numba", "rtamt", "scipy", "shapely", "zonoopt")
NOT_YET, INTERRUPTED = "its turn did not come", "interrupted"

#: Called with the number of a benchmark, its name, and the outcome, or None when it begins.
Tell = Callable[[int, str, Outcome | None], None]


def run(names: Sequence[str], keep: Callable[[Report], None], plots: Path, tell: Tell, *, quick: bool) -> Report:
    """Run benchmarks; ``keep`` is called with the report before the first of them and after each.

    One that raises is marked as failed, and the others go on; SIGINT and SIGTERM end the run with what was finished
    (in the main thread; in others they are not heard). Plots are drawn into ``plots``.
    """
    outcomes = {name: Outcome(status="not run", message=NOT_YET) for name in names}
    where = conditions()

    def report() -> Report:
        complete = all(outcome.status == "done" for outcome in outcomes.values())
        return Report(complete=complete, quick=quick, conditions=where, benchmarks=outcomes)

    with Interruption() as interruption:
        try:
            with interruption.held():
                keep(report())
            for number, name in enumerate(names, 1):
                tell(number, name, None)
                outcome = _measure(name, plots, interruption, quick=quick)
                with interruption.held():
                    outcomes[name] = outcome
                    keep(report())
                    tell(number, name, outcome)
        except KeyboardInterrupt as error:
            # Noted first, so that nothing comes between any more.
            interruption.is_cause_of(error)
            for name in names:
                if outcomes[name].message == NOT_YET:
                    outcomes[name] = Outcome(status="not run", message=INTERRUPTED)
            keep(report())
    return report()


def interrupted(report: Report) -> bool:
    """Whether a run was ended by a signal."""
    return any(outcome.message == INTERRUPTED for outcome in report.benchmarks.values())


def _measure(name: str, plots: Path, interruption: Interruption, *, quick: bool) -> Outcome:
    """What became of a benchmark; raise ``KeyboardInterrupt`` if a signal came, whatever was made of it inside."""
    outcome = _attempt(name, plots, interruption, quick=quick)
    if interruption.asked:
        raise KeyboardInterrupt
    return outcome


def _attempt(name: str, plots: Path, interruption: Interruption, *, quick: bool) -> Outcome:
    began = time.perf_counter()
    table = None
    try:
        module = import_module(f"benchmarks.{name}")
        table = module.run(quick)
        seconds = time.perf_counter() - began
        plot = plots / f"{name}.png"
        if not hasattr(module, "plot"):
            return Outcome(status="done", seconds=seconds, table=table)
        draw(module, table, plot)
        return Outcome(status="done", seconds=seconds, table=table, plot=f"{plots.name}/{plot.name}")
    except Exception as error:
        # Compiled code makes a SystemError of it.
        if interruption.is_cause_of(error):
            raise KeyboardInterrupt from error
        if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] in EXTRA:
            missing = f"{error.name} is not installed: install fleet-reach[bench]"
            return Outcome(status="not run", message=missing)
        said = f"{type(error).__name__}: {error}"
        return Outcome(status="failed", message=said, seconds=time.perf_counter() - began, table=table)


def draw(module: ModuleType, table: Table, path: Path) -> None:
    """Draw the plot of a benchmark that has one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    module.plot(table).savefig(path, dpi=110, metadata={"Software": None})
