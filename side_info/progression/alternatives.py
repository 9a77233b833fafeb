"""The tableau step: what an obligation comes to at a sample, as alternatives of literals now and an obligation next.

    exp(p) = {({p}, ⊤)}             exp(Later(n, x)) = {({}, Later(n-1, x))}
    exp(x∧y) = exp(x) ⊗ exp(y)      exp(x∨y) = exp(x) ∪ exp(y)
    exp(G[0,b] x) = exp(x) ⊗ {({}, G[0,b-1] x)}         exp(F[0,b] x) = exp(x) ∪ {({}, F[0,b-1] x)}
    exp(x U[0,b] y) = exp(y) ∪ (exp(x) ⊗ {({}, x U[0,b-1] y)})

A sequence of samples fulfils the obligation exactly if there is an alternative whose literals its first sample
fulfils and whose next obligation the rest fulfils. These keep that:

* alternatives with the same literals become one, their next obligations a disjunction;
* an alternative goes where another one asks for no more literals and its next obligation is entailed by this one's.

This one only enlarges: where there would be more than ``most`` alternatives, some give way to their common part, an
alternative of the literals they share and of what all of their next obligations entail. In a conjunction the
conjuncts of most alternatives give way first.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce
from operator import and_
from typing import Final

from side_info.progression.nodes import FALSE, TRUE, All, Always, Eventually, Later, Now, Some, Truth, Until
from side_info.progression.obligations import Obligations
from side_info.progression.weakening import Weakening

# Products up to this multiple of the most alternatives are tried: what is left after the antichain may be few enough.
_TRIED: Final = 4


@dataclass(frozen=True, slots=True)
class Alternative:
    """One way to fulfil an obligation: ``literals`` hold at this sample, and obligation ``next`` from the next on."""

    literals: frozenset[int]
    next: int


#: Literals as bits of an integer, and the obligation that is left.
Way = tuple[int, int]


class Tableau:
    """Alternatives of ``obligations``, memoised, at most ``most`` each."""

    def __init__(self, obligations: Obligations, weakening: Weakening, most: int) -> None:
        self._obligations = obligations
        self._weakening = weakening
        self._most = most
        self._known: dict[int, tuple[Way, ...]] = {TRUE: ((0, TRUE),), FALSE: ()}

    def ways(self, obligation: int) -> tuple[Way, ...]:
        """The alternatives of an obligation, fewest literals first; none if it cannot be fulfilled."""
        known = self._known.get(obligation)
        if known is None:
            known = self._known[obligation] = tuple(self._expand(obligation))
        return known

    def _expand(self, obligation: int) -> Iterable[Way]:
        build = self._obligations
        node = build.nodes[obligation]
        match node:
            case Now(literal):
                return [(1 << literal, TRUE)]
            case Later():
                return [(0, build.later(-1, obligation))]
            case All(members):
                return self._product(members)
            case Some(members):
                return self._fewest(way for member in members for way in self.ways(member))
            case Always(last, operand):
                return self._with_rest(operand, build.always(last - 1, operand))
            case Eventually(last, operand):
                return self._fewest([*self.ways(operand), (0, build.eventually(last - 1, operand))])
            case Until(last, left, right):
                waiting = self._with_rest(left, build.until(last - 1, left, right))
                return self._fewest([*self.ways(right), *waiting])
            case Truth():
                raise AssertionError("true and false are known from the start")

    def _with_rest(self, operand: int, rest: int) -> list[Way]:
        join = self._obligations.conjunction
        return self._fewest((literals, join((left, rest))) for literals, left in self.ways(operand))

    def _product(self, members: tuple[int, ...]) -> list[Way]:
        join = self._obligations.conjunction
        ways = [self.ways(member) for member in members]
        if not all(ways):
            return []
        single = [way[0] for way in ways if len(way) == 1]
        product: list[Way] = [(0, TRUE)]
        full = False
        # Stable: of conjuncts with as many alternatives the first ones keep theirs.
        for factor in sorted((way for way in ways if len(way) > 1), key=len):
            if not full and len(product) * len(factor) <= _TRIED * self._most:
                candidate = self._minimal((a | b, join((x, y))) for a, x in product for b, y in factor)
                if len(candidate) <= self._most:
                    product = candidate
                    continue
            full = True
            single.append(self._common(factor))
        literals = reduce(lambda a, b: a | b, (way[0] for way in single), 0)
        rest = [way[1] for way in single]
        return self._minimal((literals | a, join((x, *rest))) for a, x in product)

    def _fewest(self, ways: Iterable[Way]) -> list[Way]:
        """The ways, without those that others make needless, and no more than the most."""
        minimal = self._minimal(ways)
        if len(minimal) <= self._most:
            return minimal
        # The ways of most literals are the most special ones: what is lost with them is least.
        kept = self._most - 1
        return self._minimal([*minimal[:kept], self._common(minimal[kept:])])

    def _common(self, ways: Iterable[Way]) -> Way:
        """One way that is open wherever one of the ways is."""
        ways = list(ways)
        return reduce(and_, (way[0] for way in ways)), self._weakening.common(way[1] for way in ways)

    def _minimal(self, ways: Iterable[Way]) -> list[Way]:
        build = self._obligations
        rests: dict[int, set[int]] = {}
        for literals, rest in ways:
            rests.setdefault(literals, set()).add(rest)
        merged = [(literals, build.disjunction(rest)) for literals, rest in rests.items()]
        kept: list[Way] = []
        # Literals differ by now: whoever asks for no more has fewer, and comes first.
        for literals, rest in sorted(merged, key=lambda way: (way[0].bit_count(), way[0])):
            if rest != FALSE and not any(a & literals == a and build.entails(rest, other) for a, other in kept):
                kept.append((literals, rest))
        return kept
