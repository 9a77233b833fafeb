"""Progression: formulas as obligations that step from sample to sample, in a table that all vehicles of a class share.

The parts, each a module: ``discrete`` (time to steps), ``obligations`` (canonical form), ``alternatives`` (the tableau
step), ``expansion`` (many at once), ``beliefs`` (what may be left of a vehicle), ``elapsing`` (many samples that
nothing is known of), ``weakening``, ``text``.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from operator import and_, or_
from typing import Final

from side_info.progression.alternatives import Alternative, Tableau
from side_info.progression.discrete import Grid, Numbering, discrete
from side_info.progression.disjunctions import DEAD, Beliefs
from side_info.progression.expansion import Bools, Expander, Expansion, Ints
from side_info.progression.nodes import FALSE, TRUE
from side_info.progression.obligations import Obligations
from side_info.progression.text import obligation_text
from side_info.progression.weakening import Weakening
from side_info.stl.nnf import Normal

__all__ = ["DEAD", "FALSE", "TRUE", "Alternative", "Expansion", "Grid", "Table", "frontier"]


class Table:
    """Obligations and their alternatives, numbered; grows when something new is asked for.

    Formulas are progressed from sample to sample [BK00] by the tableau rules [Wol85] (mathematics, 4.5 to 4.8). An
    obligation has at most ``max_alternatives`` alternatives and a belief as many members; beyond that they are
    weakened. Without that, and on a grid without slack, jitter and continuous meaning, everything is exact but for
    ``cap``; else outer: what is fulfilled stays so. Raises ``ValueError`` for less than one alternative. Not for
    several threads.
    """

    def __init__(self, *, max_alternatives: int = 64) -> None:
        if max_alternatives < 1:
            raise ValueError(f"at most {max_alternatives} alternatives: expected one or more")
        self.max_alternatives: Final = max_alternatives
        self._obligations = Obligations()
        self._weakening = Weakening(self._obligations)
        self._tableau = Tableau(self._obligations, self._weakening, max_alternatives)
        self._expander = Expander(self._obligations, self._tableau)
        self._beliefs = Beliefs(self._obligations, self._tableau, self._weakening, max_alternatives)

    def __len__(self) -> int:
        """Number of the obligations so far."""
        return len(self._obligations)

    def add(self, formula: Normal, grid: Grid, literal: Numbering, *, lead: int = 0) -> int:
        """The obligation that follows from a formula at time zero, from the sample of grid index ``-lead`` on.

        ``literal`` maps a predicate and a margin (ns of motion, 0 but under continuous meaning) to the number of a
        literal, 0 or more. Where samples before grid index ``-lead`` may have been taken, ``lead`` has to be
        ``grid.lead``: with more slack than a step one of them can be what an ``eventually`` waits for. Raises
        ``ValueError`` for a negative lead.
        """
        if lead < 0:
            raise ValueError(f"lead {lead}: expected 0 or more")
        return discrete(formula, grid, literal, self._obligations, lead)

    def conjunction(self, obligations: Iterable[int]) -> int:
        """All of the obligations; exact."""
        return self._obligations.conjunction(obligations)

    def alternatives(self, obligation: int) -> tuple[Alternative, ...]:
        """Ways to fulfil the obligation, none of which makes another one needless; none if it cannot be fulfilled."""
        return tuple(Alternative(_indices(literals), rest) for literals, rest in self._tableau.ways(obligation))

    def expand(self, obligations: Ints) -> Expansion:
        """Alternatives of ``obligations`` (R,) in one go."""
        return self._expander.expand(obligations)

    def masks(self, literal_sets: Ints, count: int) -> Bools:
        """(A, count): whether each of the ``literal_sets`` (A,) has literal l in it, for the literals below
        ``count``."""
        return self._expander.masks(literal_sets, count)

    def subsumption(self, expansion: Expansion) -> tuple[Ints, Ints]:
        """Pairs (i, j) of alternatives of one row, where the next obligation of i entails that of j.

        Alternative i may be dropped if the literals of j that i lacks hold on the whole set of the row: the set of j
        has that of i in it then. So may all such i at once, even where j is among them: the pairs are transitive and
        without cycles, so that one stays whose set has all of theirs in it.
        """
        return self._expander.subsumption(expansion)

    def entails(self, first: int, second: int) -> bool:
        """Whether what fulfils the first certainly fulfils the second; structural, so False means nothing."""
        return self._obligations.entails(first, second)

    def antichain(self, obligations: Iterable[int]) -> tuple[int, ...]:
        """The weakest of the obligations, one of each that are equal: their disjunction is that of all; exact."""
        return self._obligations.antichain(obligations, weakest=True)

    def cap(self, obligations: Sequence[int], most: int) -> dict[int, int]:
        """Each obligation → one that it entails, of which there are at most ``most``; the same for any order."""
        return self._weakening.cap(obligations, most)

    def belief(self, obligations: Iterable[int]) -> int:
        """The belief that one of the obligations holds; ``DEAD`` if there is none, or only false."""
        return self._beliefs.belief(obligations)

    def members(self, belief: int) -> tuple[int, ...]:
        """The obligations of a belief."""
        return self._beliefs.members(belief)

    def literals_of(self, belief: int) -> frozenset[int]:
        """Literals that some alternative of the belief asks for at this sample."""
        return self._beliefs.literals_of(belief)

    def after(self, belief: int, false: frozenset[int]) -> int:
        """The belief after a sample at which the literals ``false`` certainly do not hold; others may."""
        return self._beliefs.after(belief, false)

    def skip(self, belief: int, steps: int = 1) -> int:
        """The belief after samples that nothing is known of."""
        return self._beliefs.skip(belief, steps)

    def renewed(self, beliefs: Iterable[int]) -> tuple["Table", dict[int, int]]:
        """A table that knows of some beliefs only, and their numbers there: who follows vehicles for days forgets what
        has been."""
        table = Table(max_alternatives=self.max_alternatives)
        moved = self._obligations.copied_to(table._obligations)
        return table, {belief: table.belief(map(moved, self.members(belief))) for belief in set(beliefs)}

    def text(self, obligation: int, name: Callable[[int], str]) -> str:
        """The obligation for people, windows in steps from now."""
        return obligation_text(self._obligations, obligation, name)


def frontier(table: Table, root: int, steps: int) -> list[tuple[frozenset[int], frozenset[int]]]:
    """Per step, from ``root`` on: literals asked for in every alternative that can be reached, and in some."""
    asked: list[tuple[frozenset[int], frozenset[int]]] = []
    obligations = {root}
    for _ in range(steps):
        ways = [way for one in obligations for way in table.alternatives(one)]
        sets = [way.literals for way in ways]
        asked.append((reduce(and_, sets, sets[0]), reduce(or_, sets)) if sets else (frozenset(), frozenset()))
        obligations = set(table.cap([way.next for way in ways], table.max_alternatives).values())
    return asked


def _indices(bits: int) -> frozenset[int]:
    return frozenset(i for i in range(bits.bit_length()) if bits >> i & 1)
