"""Obligations that are certainly fulfilled wherever given ones are: what they have in common, and fewer of them."""

from collections.abc import Iterable, Sequence
from functools import reduce
from itertools import combinations

from side_info.progression.nodes import FALSE, TRUE, Some
from side_info.progression.obligations import Obligations


class Weakening:
    """What several of ``obligations`` have in common, memoised."""

    def __init__(self, obligations: Obligations) -> None:
        self._obligations = obligations
        self._common: dict[tuple[int, int], int] = {}
        self._capped: dict[tuple[frozenset[int], int], dict[int, int]] = {}

    def common(self, obligations: Iterable[int]) -> int:
        """An obligation that each of the obligations entails: conjuncts that all of them entail."""
        return reduce(self._common_of_two, sorted(set(obligations)), FALSE)

    def cap(self, obligations: Sequence[int], most: int) -> dict[int, int]:
        """Each obligation → itself or a weaker one, of which there are at most ``most``; the same for any order.

        Joins two at a time, those that lose the fewest conjuncts by it.
        """
        if most < 1:
            raise ValueError(f"at most {most} obligations: expected one or more")
        key = (frozenset(obligations), most)
        if (known := self._capped.get(key)) is None:
            known = self._capped[key] = self._cap(key[0], most)
        return dict(known)

    def _cap(self, obligations: frozenset[int], most: int) -> dict[int, int]:
        weaker = {one: one for one in sorted(obligations)}
        alive = set(weaker)
        losses = {pair: self._loss(*pair) for pair in combinations(sorted(alive), 2)} if len(alive) > most else {}
        while len(alive) > most:
            first, second = min(losses, key=lambda pair: (losses[pair], pair))
            joined = self.common((first, second))
            weaker = {one: joined if now in (first, second) else now for one, now in weaker.items()}
            alive -= {first, second}
            losses = {pair: loss for pair, loss in losses.items() if not {first, second} & set(pair)}
            if joined not in alive:
                pairs = [(min(joined, other), max(joined, other)) for other in alive]
                losses |= {pair: self._loss(*pair) for pair in pairs}
                alive.add(joined)
        return weaker

    def _loss(self, first: int, second: int) -> int:
        parts = self._obligations.parts
        return len(parts(first)) + len(parts(second)) - 2 * len(parts(self.common((first, second))))

    def _common_of_two(self, first: int, second: int) -> int:
        # False is entailed by nothing else and entails everything.
        if FALSE in (first, second):
            return second if first == FALSE else first
        if TRUE in (first, second):
            return TRUE
        key = (first, second)
        if (known := self._common.get(key)) is None:
            entails = self._obligations.entails
            shared = [part for part in self._conjuncts(first) if entails(second, part)]
            shared += [part for part in self._conjuncts(second) if entails(first, part)]
            known = self._common[key] = self._obligations.conjunction(shared)
        return known

    def _conjuncts(self, obligation: int) -> tuple[int, ...]:
        """Conjuncts of an obligation, and what all members of a disjunction among them have in common."""
        build = self._obligations
        found: tuple[int, ...] = ()
        for part in build.parts(obligation):
            found += (part,)
            delay, operand = build.split(part)
            node = build.nodes[operand]
            if isinstance(node, Some):
                found += build.parts(build.later(delay, self.common(node.members)))
        return found
