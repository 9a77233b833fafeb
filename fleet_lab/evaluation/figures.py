"""Figures of one method over all trials: by step, by run, over time."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import RecordingError
from reach_server.numeric.types import FloatArray
from reach_server.sets.gauge import common_factor
from reach_server.sets.polygon import zonotope_area

#: Checks that a run needs to be judged on its own; shorter ones are taken together with the next.
RUN_CHECKS: Final = 30
#: Checks over which the rolling coverage is taken, and how often it is told.
ROLLING: Final = 200
ROLLING_EVERY: Final = 10
#: Checks below which it says nothing.
ROLLING_LEAST: Final = 50
#: Steps whose rolling coverage is told.
ROLLING_STEPS: Final = (1, 5, 10)


@dataclass(frozen=True, slots=True)
class RunFigures:
    """How often the sets of one run held, by step; runs too short to be judged are taken together."""

    recording: str
    runs: tuple[int, ...]
    checked: tuple[int, ...]
    inside: tuple[int, ...]

    @property
    def name(self) -> str:
        """Recording and run numbers."""
        numbers = str(self.runs[0]) if len(self.runs) == 1 else f"{self.runs[0]}–{self.runs[-1]}"
        return f"{self.recording} run {numbers}"


@dataclass(frozen=True, slots=True)
class StepFigures:
    """Figures of one step of the horizon.

    ``worst_run`` is the least share of a run that lay inside. ``factor`` is what all sets of this step must be scaled
    by, about their centres, so that just the profile's confidence of the checked states lie inside; ``area_equal`` is
    the mean of their areas then, ``area_equal_median`` the median. Areas at equal coverage are those of the sets that
    were checked: enlarged by the measurement noise where the set speaks about the true state.
    """

    step: int
    checked: int
    inside: int
    area_mean: float
    area_median: float
    worst_run: float | None = None
    worst_run_name: str | None = None
    factor: float | None = None
    area_equal: float | None = None
    area_equal_median: float | None = None


@dataclass(frozen=True, slots=True)
class Rolling:
    """Coverage of the newest ``ROLLING`` checks, at first of ``ROLLING_LEAST`` or more, at some samples, by step."""

    recording: str
    sample: tuple[int, ...]
    steps: dict[int, tuple[float, ...]]


@dataclass(frozen=True, slots=True)
class Told:
    """An event that the engine told at a sample of a trial."""

    recording: str
    sample: int
    kind: str
    message: str


@dataclass(frozen=True, slots=True)
class MethodFigures:
    """Figures of one method over all trials; ``waiting`` counts the samples without a tube by reason."""

    steps: tuple[StepFigures, ...]
    update_us_median: float
    update_us_p99: float
    label_counts: dict[str, int]
    runs: tuple[RunFigures, ...]
    rolling: tuple[Rolling, ...]
    events: tuple[Told, ...]
    waiting: dict[str, int]


@dataclass(frozen=True, slots=True, eq=False)
class Checks:
    """What became of the predictions of one trial, a row a predicted sample (K), a column a step (N).

    ``area`` is that of the published sets, ``checked_area`` of those that were checked; ``offset`` (K, N, n) is
    measured minus predicted centre, ``generators`` N arrays (K, n, g) of the checked sets, None where sets are not
    zonotopes.
    """

    recording: str
    sample: NDArray[np.int64]
    run: NDArray[np.int64]
    checked: NDArray[np.bool_]
    inside: NDArray[np.bool_]
    area: FloatArray
    checked_area: FloatArray
    offset: FloatArray
    generators: tuple[FloatArray | None, ...]


@dataclass(slots=True)
class Tally:
    """Gathers what the trials of one method bring."""

    checks: list[Checks] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    labels: Counter[str] = field(default_factory=Counter)
    waiting: Counter[str] = field(default_factory=Counter)
    events: list[Told] = field(default_factory=list)

    def figures(self, horizon: int, confidence: float) -> MethodFigures:
        """The figures; raise ``RecordingError`` where nothing was predicted."""
        if not self.checks:
            reasons = "; ".join(f"{count} samples: {why}" for why, count in self.waiting.most_common(2))
            raise RecordingError(
                "no sample could be predicted: the recordings are too short for the window, or hardly any sample "
                "interval is what the profile says; give more training data with --train, or correct sample_time and "
                f"tolerance{f' ({reasons})' if reasons else ''}"
            )
        runs = by_run(self.checks)
        return MethodFigures(
            tuple(_step(self.checks, runs, h, confidence) for h in range(horizon)),
            float(np.median(self.seconds) * 1e6),
            float(np.percentile(self.seconds, 99) * 1e6),
            dict(self.labels),
            runs,
            tuple(rolling(check) for check in self.checks),
            tuple(self.events),
            dict(self.waiting),
        )


def by_run(checks: Sequence[Checks]) -> tuple[RunFigures, ...]:
    """Figures by run; a run with fewer than ``RUN_CHECKS`` checks of the first step joins the next one."""
    found: list[RunFigures] = []
    for check in checks:
        groups: list[list[int]] = []
        missing = 0
        for number in dict.fromkeys(check.run.tolist()):
            count = int(check.checked[check.run == number, 0].sum())
            if missing > 0:
                groups[-1].append(number)
                missing -= count
            else:
                groups.append([number])
                missing = RUN_CHECKS - count
        if missing > 0 and len(groups) > 1:
            short = groups.pop()
            groups[-1] += short
        for numbers in groups:
            rows = np.isin(check.run, numbers)
            checked = check.checked[rows].sum(axis=0)
            inside = (check.inside & check.checked)[rows].sum(axis=0)
            found.append(RunFigures(check.recording, tuple(numbers), tuple(checked.tolist()), tuple(inside.tolist())))
    return tuple(found)


def rolling(check: Checks) -> Rolling:
    """Rolling coverage of a trial."""
    counted = np.concatenate([np.zeros((1, check.checked.shape[1]), np.int64), np.cumsum(check.checked, axis=0)])
    held = np.concatenate([counted[:1], np.cumsum(check.inside & check.checked, axis=0)])
    steps = [step for step in ROLLING_STEPS if step <= check.checked.shape[1]]
    enough = np.asarray((counted[1:, [step - 1 for step in steps]] >= ROLLING_LEAST).all(axis=1), dtype=bool)
    indices = [k for k in range(ROLLING_EVERY - 1, len(enough), ROLLING_EVERY) if enough[k]]
    shares: dict[int, tuple[float, ...]] = {}
    for step in steps:
        total, inside = counted[:, step - 1], held[:, step - 1]
        # The newest ROLLING checks may reach back over samples that were not checked.
        first = [int(np.searchsorted(total, total[k + 1] - ROLLING, side="right")) - 1 for k in indices]
        shares[step] = tuple(
            float((inside[k + 1] - inside[f]) / (total[k + 1] - total[f]))
            for k, f in zip(indices, (max(f, 0) for f in first), strict=True)
        )
    return Rolling(check.recording, tuple(int(check.sample[k]) for k in indices), shares)


def _step(checks: Sequence[Checks], runs: Sequence[RunFigures], h: int, confidence: float) -> StepFigures:
    rows = [check.checked[:, h] for check in checks]
    total = int(sum(r.sum() for r in rows))
    if not total:
        return StepFigures(h + 1, 0, 0, 0.0, 0.0)
    held = int(sum((check.inside[:, h] & r).sum() for check, r in zip(checks, rows, strict=True)))
    areas = np.concatenate([check.area[r, h] for check, r in zip(checks, rows, strict=True)])
    judged = [run for run in runs if run.checked[h] >= RUN_CHECKS] or [run for run in runs if run.checked[h]]
    worst = min(judged, key=lambda run: run.inside[h] / run.checked[h])
    factor = _factor(checks, rows, h, confidence)
    equal = equal_median = None
    if factor is not None:
        scaled = factor**2 * np.concatenate([c.checked_area[r, h] for c, r in zip(checks, rows, strict=True)])
        equal, equal_median = float(scaled.mean()), float(np.median(scaled))
    return StepFigures(
        h + 1, total, held, float(areas.mean()), float(np.median(areas)),
        worst.inside[h] / worst.checked[h], worst.name, factor, equal, equal_median,
    )  # fmt: skip


def _factor(checks: Sequence[Checks], rows: Sequence[NDArray[np.bool_]], h: int, confidence: float) -> float | None:
    """The common factor of step h + 1; None where it does not exist (flat sets, sets that are no zonotopes)."""
    generators, offset = [], []
    for check, r in zip(checks, rows, strict=True):
        found = check.generators[h]
        if found is None:
            return None
        generators.append(found[r])
        offset.append(check.offset[r, h])
    widest = max(g.shape[2] for g in generators)
    padded = [np.pad(g, [(0, 0), (0, 0), (0, widest - g.shape[2])]) for g in generators]
    factor = common_factor(np.concatenate(padded), np.concatenate(offset), confidence)
    return factor if np.isfinite(factor) else None


def enlarged_area(generators: FloatArray, position: tuple[int, int]) -> FloatArray:
    """Area (K,) of the position part of zonotopes (K, n, g)."""
    return np.asarray(zonotope_area(generators[:, list(position)]))
