"""The suite: every benchmark after the other, and a report that is whole after each of them."""

import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any, Final, Self

from benchmarks.conditions import conditions
from benchmarks.report import Outcome, Report, Table

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


class Interrupted(KeyboardInterrupt):
    """Ctrl-C or SIGTERM."""


def run(names: Sequence[str], keep: Callable[[Report], None], plots: Path, tell: Tell, *, quick: bool) -> Report:
    """Run benchmarks; ``keep`` is called with the report before the first of them and after each.

    One that raises is marked as failed, and the others go on; SIGINT and SIGTERM end the run with what was finished.
    Plots are drawn into ``plots``. Main thread only.
    """
    outcomes = {name: Outcome(status="not run", message=NOT_YET) for name in names}
    where = conditions()

    def report() -> Report:
        complete = all(outcome.status == "done" for outcome in outcomes.values())
        return Report(complete=complete, quick=quick, conditions=where, benchmarks=outcomes)

    with _Signals() as signals:
        try:
            with signals.held():
                keep(report())
            for number, name in enumerate(names, 1):
                tell(number, name, None)
                outcome = _measure(name, plots, quick=quick)
                with signals.held():
                    outcomes[name] = outcome
                    keep(report())
                    tell(number, name, outcome)
        except Interrupted:
            with suppress(Interrupted), signals.held():
                for name in names:
                    if outcomes[name].message == NOT_YET:
                        outcomes[name] = Outcome(status="not run", message=INTERRUPTED)
                keep(report())
    return report()


def interrupted(report: Report) -> bool:
    """Whether a run was ended by a signal."""
    return any(outcome.message == INTERRUPTED for outcome in report.benchmarks.values())


def _measure(name: str, plots: Path, *, quick: bool) -> Outcome:
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
        if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] in EXTRA:
            missing = f"{error.name} is not installed: install fleet-reach[bench]"
            return Outcome(status="not run", message=missing)
        said = f"{type(error).__name__}: {error}"
        return Outcome(status="failed", message=said, seconds=time.perf_counter() - began, table=table)


def draw(module: ModuleType, table: Table, path: Path) -> None:
    """Draw the plot of a benchmark that has one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    module.plot(table).savefig(path, dpi=110, metadata={"Software": None})


class _Signals:
    """SIGINT and SIGTERM raise ``Interrupted``, but not while they are held."""

    def __init__(self) -> None:
        self._held = self._waiting = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        self._before = {number: signal.signal(number, self._raise) for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *exc_info: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _raise(self, number: int, frame: FrameType | None) -> None:
        if not self._held:
            raise Interrupted
        self._waiting = True

    @contextmanager
    def held(self) -> Iterator[None]:
        """Let nothing come between; what came is raised at the end."""
        self._held = True
        try:
            yield
        finally:
            self._held = False
        if self._waiting:
            self._waiting = False
            raise Interrupted
