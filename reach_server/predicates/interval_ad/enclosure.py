"""The left side h of a predicate ``h >= 0`` with its derivatives, enclosed over boxes of states and contexts."""

from collections.abc import Mapping
from dataclasses import dataclass

import casadi
import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.rounding import EPS, add_down, add_up
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.predicates.interface import Context
from reach_server.predicates.interval_ad.arithmetic import Bounds, holds_zero
from reach_server.predicates.interval_ad.graph import Symbolic, symbolic
from reach_server.predicates.interval_ad.tape import Enclosure, Tape
from side_info.stl.expression import Expression

#: Seconds since time zero are sums and differences of a few numbers, each rounded.
_TIME_ULPS = 4


@dataclass(frozen=True, slots=True, eq=False)
class TaylorEnclosure:
    """Bounds over R boxes of h (R,), its gradient (R, s) and Hessian (R, s, s); all of them infinite where h is not
    defined on the whole box. ``smooth`` (R,): h is twice continuously differentiable on the box where the bounds of
    its derivatives are finite."""

    value: Bounds
    gradient: Bounds
    hessian: Bounds
    smooth: BoolArray

    def __getitem__(self, rows: "slice | BoolArray | NDArray[np.intp]") -> "TaylorEnclosure":
        return TaylorEnclosure(
            _rows(self.value, rows), _rows(self.gradient, rows), _rows(self.hessian, rows), self.smooth[rows]
        )  # fmt: skip

    def __neg__(self) -> "TaylorEnclosure":
        return TaylorEnclosure(_negated(self.value), _negated(self.gradient), _negated(self.hessian), self.smooth)


class PredicateFunction:
    """h as a function of the s states at ``coordinates``, of time and of what was received last.

    ``affine``: its Hessian is zero; ``quadratic``: its Hessian is constant and h depends on states alone; ``timed``:
    it depends on time; ``everywhere``: it is defined whatever the state is.
    """

    def __init__(self, expression: Expression, index: Mapping[str, int]) -> None:
        graph = symbolic(expression, index)
        self.coordinates = graph.coordinates
        self._given = graph.given
        numbers = np.array(graph.numbers, dtype=np.float64).reshape(-1, 1)
        self._numbers = numbers, numbers
        self._demands = tuple(demand for _, demand in graph.domain)
        self._values, self._slopes, self._curves = _tapes(graph)
        hessian, _ = casadi.hessian(graph.value, graph.states)
        self.affine = hessian.nnz() == 0
        self.quadratic = not graph.given and not graph.domain and not casadi.depends_on(hessian, graph.states)
        self.everywhere = not graph.domain
        self.timed = "t" in graph.given or "last t" in graph.given

    @property
    def dimension(self) -> int:
        """How many states s it depends on."""
        return len(self.coordinates)

    def given(self, context: Context, rows: int, margin: float | None) -> Bounds:
        """Bounds (q, R) of what the context gives; of all times within ``margin`` seconds, None: as stated."""
        low, high = np.empty((len(self._given), rows)), np.empty((len(self._given), rows))
        for index, what in enumerate(self._given):
            if isinstance(what, int):
                low[index], high[index] = context.last_lower[:, what], context.last_upper[:, what]
            elif what == "k":
                low[index] = high[index] = context.k
            else:
                time = context.t if what == "t" else context.last_t
                off = 0.0 if margin is None else _TIME_ULPS * EPS * (np.abs(context.t) + np.abs(context.last_t))
                # Motion moves the time that the predicate speaks about, not that of the last sample.
                off = off + context.t_slack + (margin if margin is not None and what == "t" else 0.0)
                low[index], high[index] = add_down(time, -off), add_up(time, off)
        return low, high

    def values(self, lower: FloatArray, upper: FloatArray, given: Bounds) -> Bounds:
        """Bounds (R,) of h over boxes of states (R, s)."""
        value, domain = self._values((lower.T, upper.T), self._numbers, given)
        low, high = value.lower[0], value.upper[0]
        known = self._defined(domain)
        return np.where(known, low, -np.inf), np.where(known, high, np.inf)

    def enclosure(self, lower: FloatArray, upper: FloatArray, given: Bounds, *, curved: bool = True) -> TaylorEnclosure:
        """h and its derivatives over boxes (R, s); without the Hessian (its bounds are infinite) if not ``curved``."""
        tape = self._curves if curved else self._slopes
        value, domain, gradient, *hessian = tape((lower.T, upper.T), self._numbers, given)
        rows, s = lower.shape
        known = self._defined(domain)
        first = gradient.lower.T, gradient.upper.T
        second = np.full((rows, s, s), -np.inf), np.full((rows, s, s), np.inf)
        if hessian:
            low, high = (b.T.reshape(rows, s, s) for b in (hessian[0].lower, hessian[0].upper))
            # Both triangles bound the same numbers.
            second = np.maximum(low, np.swapaxes(low, 1, 2)), np.minimum(high, np.swapaxes(high, 1, 2))
        return TaylorEnclosure(
            _unless(~known, (value.lower[0], value.upper[0])), _unless(~known, first), _unless(~known, second),
            value.smooth & known,
        )  # fmt: skip

    def _defined(self, domain: Enclosure) -> BoolArray:
        known = np.ones(domain.lower.shape[1], dtype=bool)
        for index, demand in enumerate(self._demands):
            low, high = domain.lower[index], domain.upper[index]
            if demand == "nonzero":
                known &= ~holds_zero((low, high))
            else:
                known &= low >= 0 if demand == "nonnegative" else low > 0
        return known


def _tapes(graph: Symbolic) -> tuple[Tape, Tape, Tape]:
    hessian, gradient = casadi.hessian(graph.value, graph.states)
    domain = casadi.vertcat(*(operand for operand, _ in graph.domain)) if graph.domain else casadi.SX(0, 1)
    inputs = [graph.states, graph.constants, graph.context]
    outputs = [graph.value, casadi.densify(domain), casadi.densify(gradient), casadi.densify(hessian)]
    values, slopes, curves = (Tape(casadi.Function("h", inputs, outputs[:count])) for count in (2, 3, 4))
    return values, slopes, curves


def _rows(bounds: Bounds, rows: "slice | BoolArray | NDArray[np.intp]") -> Bounds:
    return bounds[0][rows], bounds[1][rows]


def _negated(bounds: Bounds) -> Bounds:
    return -bounds[1], -bounds[0]


def _unless(unknown: BoolArray, bounds: Bounds) -> Bounds:
    where = unknown.reshape(-1, *[1] * (bounds[0].ndim - 1))
    return np.where(where, -np.inf, bounds[0]), np.where(where, np.inf, bounds[1])
