"""Beliefs: the obligations that may be left of a vehicle, one of which holds if the formula does.

A belief is an antichain of obligations of which the weakest are kept (what a stronger one allows, a weaker one allows
too), so it stands for their disjunction. Beliefs are numbered; those of thousands of vehicles are few.
"""

from collections.abc import Iterable
from functools import reduce
from operator import or_
from typing import Final

from side_info.progression.alternatives import Tableau
from side_info.progression.nodes import FALSE
from side_info.progression.obligations import Obligations
from side_info.progression.skip import Elapsing
from side_info.progression.weakening import Weakening

DEAD: Final = 0
"""The belief of no obligation: the formula is certainly broken."""


class Beliefs:
    """Numbers of beliefs over ``tableau`` and the steps between them, memoised; at most ``most`` members each."""

    def __init__(self, obligations: Obligations, tableau: Tableau, weakening: Weakening, most: int) -> None:
        self._obligations = obligations
        self._tableau = tableau
        self._weakening = weakening
        self._most = most
        self._elapsing = Elapsing(obligations)
        self._members: list[tuple[int, ...]] = [()]
        self._numbers: dict[tuple[int, ...], int] = {(): DEAD}
        self._literals: dict[int, frozenset[int]] = {}
        self._after: dict[tuple[int, frozenset[int]], int] = {}
        self._skipped: dict[tuple[int, int], int] = {}

    def belief(self, obligations: Iterable[int]) -> int:
        """The belief that one of the obligations holds."""
        weakest = self._obligations.antichain((one for one in obligations if one != FALSE), weakest=True)
        if len(weakest) > self._most:
            capped = self._weakening.cap(weakest, self._most)
            weakest = self._obligations.antichain(capped.values(), weakest=True)
        number = self._numbers.get(weakest)
        if number is None:
            number = self._numbers[weakest] = len(self._members)
            self._members.append(weakest)
        return number

    def members(self, belief: int) -> tuple[int, ...]:
        """The obligations of a belief."""
        return self._members[belief]

    def literals_of(self, belief: int) -> frozenset[int]:
        """Literals that some alternative of the belief asks for at this sample."""
        known = self._literals.get(belief)
        if known is None:
            ways = (way for member in self._members[belief] for way in self._tableau.ways(member))
            bits = reduce(or_, (literals for literals, _ in ways), 0)
            known = self._literals[belief] = frozenset(i for i in range(bits.bit_length()) if bits >> i & 1)
        return known

    def after(self, belief: int, false: frozenset[int]) -> int:
        """The belief after a sample at which the literals ``false`` certainly do not hold; others may."""
        known = self._after.get((belief, false))
        if known is None:
            known = self._after[belief, false] = self._step(belief, false)
        return known

    def skip(self, belief: int, steps: int = 1) -> int:
        """The belief after samples that nothing is known of."""
        if steps < 0:
            raise ValueError(f"{steps} samples cannot be skipped")
        if steps == 1:
            return self.after(belief, frozenset())
        known = self._skipped.get((belief, steps))
        if known is None:
            left = [self._elapsing.after(member, steps) for member in self._members[belief]]
            known = self._skipped[belief, steps] = self.belief(left) if steps else belief
        return known

    def _step(self, belief: int, false: frozenset[int]) -> int:
        relevant = false & self.literals_of(belief)
        if relevant != false:
            return self.after(belief, relevant)
        bits = sum(1 << literal for literal in relevant)
        ways = (way for member in self._members[belief] for way in self._tableau.ways(member))
        return self.belief(rest for literals, rest in ways if not literals & bits)
