"""What predicates refer to besides the state: the time of a scenario and the newest sample, steps ahead of it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray, IndexArray, IntArray
from reach_server.predicates import Context, ContextCache, Literals
from reach_server.predicates.apply import Contexts
from reach_server.side_information.tracker import ScenarioTracker


@dataclass(frozen=True, slots=True, eq=False)
class InitialConditions:
    """When and from where tubes of some vehicles start: ``slots`` (B,), stamps ``t`` (B,) ns, and a box around each
    true state then, ``lower`` and ``upper`` (B, n)."""

    slots: IndexArray
    t: IntArray
    lower: FloatArray
    upper: FloatArray


def context_ahead(tracker: ScenarioTracker, instants: InitialConditions, k: IndexArray, step_ns: int) -> Context:
    """What the predicates of a scenario refer to ``k`` (B,) steps of ``step_ns`` after the instants (B)."""
    last = (instants.t - tracker.zero[instants.slots]) / 1e9
    t = last + k * (step_ns / 1e9)
    slack = float(tracker.slack[instants.slots].max(initial=0)) / 1e9
    return Context(t, k.astype(np.float64), last, instants.lower, instants.upper, slack)


class HorizonContexts:
    """Contexts at the instants and over the steps of a horizon after them: one series a scenario that is asked for.

    ``tracker_of`` gives the tracker of a scenario by its name.
    """

    def __init__(
        self,
        literals: Literals,
        tracker_of: Callable[[str], ScenarioTracker],
        instants: InitialConditions,
        horizon: int,
        step_ns: int,
    ) -> None:
        self._literals = literals
        self._tracker_of = tracker_of
        self._instants = instants
        self._horizon = horizon
        self._step_ns = step_ns
        self._series: dict[str, ContextCache] = {}

    def __call__(self, k: int, track: IndexArray) -> Contexts:
        """At step ``k``, for sets of rows (R,) of the instants."""
        return partial(self._of, k, track)

    def _of(self, k: int, row: IndexArray, literal: int, rows: IndexArray) -> Context:
        count = len(self._instants.slots)
        scenario = self._literals.scenario(literal)
        if scenario not in self._series:
            steps = self._horizon + 1
            every = take_rows(self._instants, np.tile(np.arange(count), steps))
            ahead = np.repeat(np.arange(steps), count)
            whole = context_ahead(self._tracker_of(scenario), every, ahead, self._step_ns)
            self._series[scenario] = ContextCache(whole)
        whole = self._series[scenario].context
        index = k * count + row[rows]
        return Context(
            whole.t[index], whole.k[index], whole.last_t[index], whole.last_lower[index], whole.last_upper[index],
            whole.t_slack, self._series[scenario], index,
        )  # fmt: skip
