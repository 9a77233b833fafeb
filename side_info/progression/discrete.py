"""Normal formulas over time to obligations over samples: nothing that the formula allows is excluded.

Sample k of a vehicle is taken at ``τ_k``, no more than the jitter j from ``k·d`` on the vehicle's grid; stamps
increase. Time zero of the formula is no more than the slack s from grid index 0. Bounds become whole steps in integer
arithmetic. Where windows are moved, those of G shrink (an empty one is true) and those of F and U grow.

*Sampled*: the formula speaks about samples. A sub-formula inside of a temporal operator is read at a sample, the
whole formula at time zero, which is no sample where ``s + j > 0``; a literal there is true.

* Read at time zero, sample k is ``k·d ± e`` away, ``e = s + j``: surely in [a, b] if ``a + e <= k·d <= b - e``,
  possibly if ``a - e <= k·d <= b + e``, surely not before time zero if ``k·d >= e``.
* Read at sample i, sample i + k is ``k·d ± 2j`` away, sample i itself exactly 0, and later samples come later. So a
  window of G from 0 on has sample i in it and needs no move of its beginning.
* ``p U[a,b] q``: q at a sample w possibly in [a, b], p at w and all before that are surely not before the reading.
* Where stamps jitter two samples may share a grid index. Then nothing is asked at that index, but that there is a
  second one shows only when it comes. So F and U wait one index longer: then the last one of the window is over.

*Continuous*: the formula speaks about every instant. ``W(φ, s, m)`` at sample k is what follows for the samples k,
k + 1, … from φ at some instant t with ``|t - k·d| <= s`` and ``|t - τ_k| <= m``; at time zero it is W(φ, s, s + j):

* literal: the state of sample k was there up to m earlier or later; so much motion is its margin.
* G[a,b] φ: sample k + i is ``i·d ± (s + j)`` from t: W(φ, j, 0) at those surely in the window.
* F[a,b] φ: witnessed at t' in [t + a, t + b]. Grid index w nearest to t' (the later one of two) is no more than d/2
  from it: W(φ, d/2, d/2 + j) at w, where ``w - k`` is between the integers nearest to ``(a - s)/d`` and ``(b + s)/d``.
* p U[a,b] q: W(q, d/2, d/2 + j) at w as above. A sample i < w is taken at ``τ_i <= (w - 1)·d + j <= t' - d/2 + j``, not
  after t', so p was true there if ``τ_i >= t``, which holds for ``(i - k)·d >= s + j``: W(p, j, 0) at these. It is not
  asked at w itself.
* Inside, s is j or d/2, not more than d/2; so no witness t' >= t is nearest to a grid index before k.

The first index is kept from being negative: inside for the reasons given (stamps increase; s is not more than d/2), at
time zero because there is no sample before ``-lead`` or none that could be a witness.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from side_info.progression.nodes import FALSE, TRUE
from side_info.progression.obligations import Obligations
from side_info.stl.nnf import Conjunction, Constant, Disjunction, Finally, Globally, Literal, Normal, Until

#: Predicate and margin (ns of motion) → number of the literal.
Numbering = Callable[[int, int], int]


@dataclass(frozen=True, slots=True)
class Grid:
    """Where the samples of a vehicle are, in ns: every ``step_ns``, off by at most ``jitter_ns`` each.

    Grid index 0 is time zero of the formula but for ``slack_ns``. ``continuous``: the formula speaks about
    every instant, not about samples. Raises ``ValueError`` for a step that is not positive, a negative slack, and a
    jitter of more than half a step.
    """

    step_ns: int
    slack_ns: int = 0
    continuous: bool = False
    jitter_ns: int = 0

    def __post_init__(self) -> None:
        if self.step_ns <= 0 or self.slack_ns < 0 or not 0 <= 2 * self.jitter_ns <= self.step_ns:
            raise ValueError(f"{self}: expected a positive step, a slack >= 0, a jitter of 0 to half a step")

    @property
    def lead(self) -> int:
        """Samples before grid index 0 that may be witnesses of the formula, if there were samples then."""
        if self.continuous:
            return max(0, -self.nearest(-self.slack_ns))
        return (self.slack_ns + self.jitter_ns) // self.step_ns

    @property
    def half_ns(self) -> int:
        """Half a step, rounded up."""
        return (self.step_ns + 1) // 2

    def ceil(self, time_ns: int) -> int:
        """Index of the first grid point at that time or after it."""
        return -(-time_ns // self.step_ns)

    def floor(self, time_ns: int) -> int:
        """Index of the last grid point at that time or before it."""
        return time_ns // self.step_ns

    def nearest(self, time_ns: int) -> int:
        """Index of the nearest grid point, the later one of two."""
        return (2 * time_ns + self.step_ns) // (2 * self.step_ns)


def discrete(formula: Normal, grid: Grid, literal: Numbering, build: Obligations, lead: int = 0) -> int:
    """The obligation, from the sample of grid index ``-lead`` on, that follows from the formula at time zero.

    Exact for sampled meaning without slack and jitter, outer otherwise. A witness before grid index ``-lead`` is not
    expected: either the signal begins there or ``lead >= grid.lead``.
    """
    translate = _Continuous if grid.continuous else _Sampled
    return translate(grid, literal, build, lead).at_zero(formula)


class _Sampled:
    def __init__(self, grid: Grid, literal: Numbering, build: Obligations, lead: int) -> None:
        self._grid, self._literal, self._build, self._lead = grid, literal, build, lead

    def at_zero(self, formula: Normal) -> int:
        grid, build, lead = self._grid, self._build, self._lead
        off = grid.slack_ns + grid.jitter_ns
        match formula:
            case Literal(predicate):
                return TRUE if off else build.later(lead, build.now(self._literal(predicate, 0)))
            case Globally(start, end, operand):
                inside = self.at_sample(operand)
                return build.always_in(grid.ceil(start + off) + lead, grid.floor(end - off) + lead, inside)
            case Finally(start, end, operand):
                return build.eventually_in(*self._witness(start, end, off, lead), self.at_sample(operand))
            case Until(start, end, left, right):
                return self._until(*self._witness(start, end, off, lead), grid.ceil(off) + lead, left, right)
        return _boolean(formula, self.at_zero, build)

    def at_sample(self, formula: Normal) -> int:
        grid, build = self._grid, self._build
        off = 2 * grid.jitter_ns
        match formula:
            case Literal(predicate):
                return build.now(self._literal(predicate, 0))
            case Globally(0, end, operand):
                return build.always(max(grid.floor(end - off), 0), self.at_sample(operand))
            case Globally(start, end, operand):
                return build.always_in(grid.ceil(start + off), grid.floor(end - off), self.at_sample(operand))
            case Finally(start, end, operand):
                return build.eventually_in(*self._witness(start, end, off), self.at_sample(operand))
            case Until(start, end, left, right):
                return self._until(*self._witness(start, end, off), 0, left, right)
        return _boolean(formula, self.at_sample, build)

    def _witness(self, start: int, end: int, off: int, lead: int = 0) -> tuple[int, int]:
        """First and last sample that may be a witness in the window."""
        more = 1 if self._grid.jitter_ns else 0
        return max(self._grid.ceil(start - off) + lead, 0), self._grid.floor(end + off) + lead + more

    def _until(self, first: int, last: int, unasked: int, left: Normal, right: Normal) -> int:
        kept = self.at_sample(left)
        witness = self._build.conjunction((kept, self.at_sample(right)))
        return self._build.until_in(first, last, unasked, kept, witness)


class _Continuous:
    def __init__(self, grid: Grid, literal: Numbering, build: Obligations, lead: int) -> None:
        self._grid, self._literal, self._build, self._lead = grid, literal, build, lead

    def at_zero(self, formula: Normal) -> int:
        slack, jitter = self._grid.slack_ns, self._grid.jitter_ns
        return self._near(formula, slack, slack + jitter, self._lead)

    def _near(self, formula: Normal, slack: int, margin: int, lead: int = 0) -> int:
        """``W(formula, slack, margin)``, counted from the sample ``lead`` steps before the one it is read at."""
        grid, build = self._grid, self._build
        off = slack + grid.jitter_ns
        match formula:
            case Literal(predicate):
                return build.later(lead, build.now(self._literal(predicate, margin)))
            case Globally(start, end, operand):
                inside = self._at_sample(operand)
                return build.always_in(grid.ceil(start + off) + lead, grid.floor(end - off) + lead, inside)
            case Finally(start, end, operand):
                return build.eventually_in(*self._witness(start, end, slack, lead), self._near_sample(operand))
            case Until(start, end, left, right):
                kept, witness = self._at_sample(left), self._near_sample(right)
                first, last = self._witness(start, end, slack, lead)
                return build.until_in(first, last, grid.ceil(off) + lead, kept, witness)
        return _boolean(formula, lambda operand: self._near(operand, slack, margin, lead), build)

    def _at_sample(self, formula: Normal) -> int:
        return self._near(formula, self._grid.jitter_ns, 0)

    def _near_sample(self, formula: Normal) -> int:
        half = self._grid.half_ns
        return self._near(formula, half, half + self._grid.jitter_ns)

    def _witness(self, start: int, end: int, slack: int, lead: int) -> tuple[int, int]:
        """First and last sample that may be nearest to a witness in the window."""
        return max(self._grid.nearest(start - slack) + lead, 0), self._grid.nearest(end + slack) + lead


def _boolean(formula: Normal, translate: Callable[[Normal], int], build: Obligations) -> int:
    match formula:
        case Constant(value):
            return TRUE if value else FALSE
        case Conjunction(operands):
            return build.conjunction(_each(operands, translate))
        case Disjunction(operands):
            return build.disjunction(_each(operands, translate))
    raise TypeError(f"no formula in normal form: {formula!r:.80}")


def _each(operands: tuple[Normal, ...], translate: Callable[[Normal], int]) -> Iterable[int]:
    return [translate(operand) for operand in operands]
