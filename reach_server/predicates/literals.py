"""The predicates of a vehicle class, compiled once."""

import heapq
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.predicates.affine import AffineEnclosure, affine_in_states
from reach_server.predicates.convex_region import ConvexRegionEnclosure, disc_expression, disc_strips, ellipsoid_strips
from reach_server.predicates.halfspace import FixedStrips, HalfspaceEnclosure
from reach_server.predicates.interface import Context, PredicateEnclosure, StateUncertainty, Strips, Verdict
from reach_server.predicates.interval_ad.enclosure import PredicateFunction
from reach_server.predicates.nonlinear import NonlinearEnclosure
from side_info.stl.expression import Last, Steps, nodes_of
from side_info.stl.predicates import DiscPredicate, LinearPredicate, NonlinearPredicate, Predicate


@dataclass(frozen=True, slots=True, eq=False)
class _Entry:
    scenario: str
    name: str
    enclosure: PredicateEnclosure
    looks_back: bool


class Literals:
    """Predicates as literals of formulas, numbered from 0 in the order in which they came; a new one takes the least
    number that was released.

    Cuts are outer: no state that satisfies a predicate is lost (mathematics, 4.11 to 4.18). Predicates become tangents
    and linearisations whose remainder is bounded over zonotopes [Alt10] by interval arithmetic [Moo66].

    Args:
        n: states of the class.
        plane: the position states.
        noise: generators (n, g) by which the states that the cut sets speak about may differ from the true ones, with
            g = 0 for sets of true states; None or infinite where that is not known, so that no predicate can cut.
    """

    def __init__(self, n: int, plane: tuple[int, int] | None, noise: FloatArray | None) -> None:
        self._n = n
        self.plane = plane
        known = noise is not None and bool(np.isfinite(noise).all())
        self._noise = np.array(noise, dtype=np.float64).reshape(n, -1) if known else None
        #: By number; None for one that was released.
        self._entries: list[_Entry | None] = []
        self._known: dict[tuple[object, ...], int] = {}
        self._free: list[int] = []
        self._fixed_strips: dict[int, Strips] = {}

    def add(
        self,
        predicate: Predicate,
        index: Mapping[str, int],
        *,
        scenario: str,
        name: str,
        speed: FloatArray | float = 0.0,
        margin_ns: int = 0,
    ) -> int:
        """The number of a literal: ``predicate`` holds at some time up to ``margin_ns`` from the sample.

        ``index`` gives the position of each of the scenario's states in the state vector, ``speed`` (n,) bounds how
        fast states move, per second, in the units of the profile; ``k`` and the last received state are those of the
        sample. The same literal again has the same number. Raises ``ScenarioError`` for a predicate that cannot be
        compiled.
        """
        margin = margin_ns * 1e-9 * (1 + 4 * EPS)
        motion = np.broadcast_to(np.asarray(speed, dtype=np.float64), (self._n,)) * margin
        key = (scenario, name, margin_ns, motion.tobytes(), _content(predicate), tuple(sorted(index.items())))
        if key not in self._known:
            noise = np.zeros((self._n, 0)) if self._noise is None else self._noise
            enclosure = self._compiled(predicate, index, StateUncertainty(noise, motion, margin))
            entry = _Entry(scenario, name, enclosure, _looks_back(predicate))
            if self._free:
                number = heapq.heappop(self._free)
                self._entries[number] = entry
            else:
                number = len(self._entries)
                self._entries.append(entry)
            self._known[key] = number
        return self._known[key]

    def release(self, live: Collection[int]) -> None:
        """Forget all literals but the ``live`` ones. Only when no table and no schedule refers to them any more."""
        released = {number for number, entry in enumerate(self._entries) if entry is not None} - set(live)
        self._known = {key: number for key, number in self._known.items() if number not in released}
        for number in released:
            self._entries[number] = None
            self._fixed_strips.pop(number, None)
            heapq.heappush(self._free, number)

    @property
    def held(self) -> int:
        """How many literals there are that were not released."""
        return len(self._entries) - len(self._free)

    @property
    def looks_back(self) -> BoolArray:
        """Which literals (L,) refer to the path since the last received sample."""
        return np.array([entry is not None and entry.looks_back for entry in self._entries], dtype=bool)

    @property
    def count(self) -> int:
        """One more than the greatest number that a literal has had."""
        return len(self._entries)

    def _entry(self, literal: int) -> _Entry:
        entry = self._entries[literal]
        if entry is None:
            raise KeyError(f"literal {literal} was released")
        return entry

    def scenario(self, literal: int) -> str:
        """The scenario that a literal belongs to, empty for one that was released."""
        entry = self._entries[literal]
        return "" if entry is None else entry.scenario

    def name(self, literal: int) -> str:
        """The name of its predicate, empty for one that was released."""
        entry = self._entries[literal]
        return "" if entry is None else entry.name

    def fixed(self, literal: int) -> bool:
        """Whether its strips depend neither on the set nor on the context."""
        return self._noise is None or self._entry(literal).enclosure.fixed

    def fixed_strips(self, literal: int) -> Strips:
        """The strips (C,) of a literal for which they depend neither on the set nor on the context: outer."""
        found = self._fixed_strips.get(literal)
        if found is None:
            nothing = np.zeros((0, self._n))
            nowhere = Context(nothing[:, 0], nothing[:, 0], nothing[:, 0], nothing, nothing)
            found, _ = self.strips(literal, nothing, nothing[:, :, None], nowhere)
            self._fixed_strips[literal] = found
        return found

    def verdict(self, ids: Sequence[int], center: FloatArray, generators: FloatArray, context: Context) -> Verdict:
        """Verdicts of the literals ``ids`` (L,) on sets of *true* states, ``center`` (R, n), ``generators`` (R, n, g):
        (R, L).

        ``HOLDS`` of all states of the set, ``NEVER`` of one, both certain; ``MAY_HOLD``: not known.
        """
        found = np.zeros((len(center), len(ids)), dtype=np.int8)
        for column, literal in enumerate(ids if len(center) else ()):
            found[:, column] = self._entry(literal).enclosure.verdict(center, generators, context)
        return found

    def strips(
        self, literal: int, center: FloatArray, generators: FloatArray, context: Context
    ) -> tuple[Strips, BoolArray]:
        """Strips that hold for every state of the sets, ``center`` (R, n), ``generators`` (R, n, g), whose true state
        may satisfy the literal.

        Outer bounds; ``empty`` (R,): there certainly is no such state.
        """
        if self._noise is None:
            nothing = np.zeros(0)
            return Strips(np.zeros((0, self._n)), nothing, nothing), np.zeros(len(center), dtype=bool)
        return self._entry(literal).enclosure.strips(center, generators, context)

    def _compiled(
        self, predicate: Predicate, index: Mapping[str, int], uncertainty: StateUncertainty
    ) -> PredicateEnclosure:
        if isinstance(predicate, LinearPredicate):
            normal = np.zeros((1, self._n))
            for state, coefficient in predicate.coefficients.items():
                normal[0, index[state]] += coefficient
            bounds = np.array([predicate.lower]), np.array([predicate.upper])
            return HalfspaceEnclosure(FixedStrips(normal, *bounds, uncertainty))
        if isinstance(predicate, DiscPredicate):
            enclosure = NonlinearEnclosure(PredicateFunction(disc_expression(predicate), index), self._n, uncertainty)
            return ConvexRegionEnclosure(disc_strips(predicate, index, self._n, uncertainty), enclosure)
        function = PredicateFunction(predicate.expression, index)
        if affine_in_states(predicate.expression) and function.everywhere and function.coordinates:
            return AffineEnclosure(function, self._n, uncertainty)
        enclosure = NonlinearEnclosure(function, self._n, uncertainty)
        region = ellipsoid_strips(enclosure.function, self._n, uncertainty)
        return enclosure if region is None else ConvexRegionEnclosure(region, enclosure)


def _looks_back(predicate: Predicate) -> bool:
    if not isinstance(predicate, NonlinearPredicate):
        return False
    return any(isinstance(node, Last | Steps) for node in nodes_of(predicate.expression))


def _content(predicate: Predicate) -> tuple[object, ...]:
    """A hashable value that says what a predicate says."""
    match predicate:
        case LinearPredicate(_, coefficients, lower, upper):
            return tuple(coefficients.items()), lower, upper
        case DiscPredicate(_, center, radius):
            return tuple(center.items()), radius
        case NonlinearPredicate(_, expression):
            return (expression,)
