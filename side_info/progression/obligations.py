"""Hash-consed obligations in a canonical form, so that what means the same is mostly the same number.

Each rewriting here is an equivalence over sequences of samples, one sample a step (``x@i``: x holds at sample i):

* ``Later`` moves into conjunctions and out of everything else: ``(x∧y)@n = x@n ∧ y@n``, and G, F, U and ∨ do not
  care from where steps are counted. So a window [a, b] is ``Later(a, …(b-a))``, and ``p U[a,b] q`` is
  ``G[0,a-1] p ∧ Later(a, p U[0,b-a] q)``: p at all samples before the witness, those before a included.
* ``G(x∧y) = Gx ∧ Gy``; ``G[0,b] G[0,c] = G[0,b+c]`` and the same for F: on whole steps the windows leave no gap.
* Of windows of one operand, ``G[a,b] ∧ G[c,d] = G[a,d]`` and ``F[a,b] ∨ F[c,d] = F[a,d]`` where a <= c <= b + 1: there
  is no sample between b and b + 1. An operand that stands alone is a window of one sample.
* A conjunct that another one entails says nothing, nor does a disjunct that entails another one.
* ``⊤ U q = F q``; ``p U q = q`` where p entails q: p is asked now, unless q holds now.

``F`` is not moved into disjunctions: that would make two waiting obligations of one.
"""

from collections.abc import Callable, Iterable
from functools import cache
from typing import Final

from side_info.progression.entailment import Entailment
from side_info.progression.nodes import FALSE, TRUE, All, Always, Eventually, Later, Node, Now, Some, Truth, Until

_Window = tuple[int, int]


class Obligations:
    """Numbers of obligations, and the constructors that keep them canonical.

    Everything is memoised and nothing is dropped: there are as many obligations as the formulas that were put in
    have residues, bounded by their lengths in steps.
    """

    def __init__(self) -> None:
        self.nodes: Final[list[Node]] = [Truth(True), Truth(False)]
        self.entails: Final = Entailment(self.nodes)
        self._numbers: dict[Node, int] = {Truth(True): TRUE, Truth(False): FALSE}
        self._joined: dict[tuple[bool, frozenset[int]], int] = {}

    def __len__(self) -> int:
        return len(self.nodes)

    def now(self, literal: int) -> int:
        return self._number(Now(literal))

    def delay(self, obligation: int) -> int:
        """Samples, from this one on, that the obligation asks nothing of and that it is not witnessed by."""
        match self.nodes[obligation]:
            case Later(delay):
                return delay
            case All(members):
                return min(map(self.delay, members))
        return 0

    def split(self, obligation: int) -> tuple[int, int]:
        """Delay and what is delayed of an obligation that is no conjunction."""
        node = self.nodes[obligation]
        return (node.delay, node.operand) if isinstance(node, Later) else (0, obligation)

    def parts(self, obligation: int) -> tuple[int, ...]:
        """Obligations whose conjunction this is; none for true."""
        if obligation == TRUE:
            return ()
        node = self.nodes[obligation]
        return node.members if isinstance(node, All) else (obligation,)

    def later(self, steps: int, obligation: int) -> int:
        """The obligation, ``steps`` samples from now; by a negative number, down to its delay, it comes sooner."""
        if not steps or obligation in (TRUE, FALSE):
            return obligation
        node = self.nodes[obligation]
        if isinstance(node, All):
            # Shifting a conjunction in canonical form by the same for all leaves the form.
            return self._number(All(tuple(sorted(self.later(steps, member) for member in node.members))))
        delay, operand = self.split(obligation)
        if delay + steps < 0:
            raise ValueError(f"obligation {obligation} begins in {delay} samples: cannot come {-steps} sooner")
        return self._number(Later(delay + steps, operand)) if delay + steps else operand

    def always(self, last: int, operand: int) -> int:
        """The operand at samples 0 to ``last``."""
        if last == 0 or operand in (TRUE, FALSE):
            return operand
        match self.nodes[operand]:
            case All(members):
                return self.conjunction(self.always(last, member) for member in members)
            case Later(delay, inner):
                return self.later(delay, self.always(last, inner))
            case Always(inner_last, inner):
                return self._number(Always(last + inner_last, inner))
        return self._number(Always(last, operand))

    def eventually(self, last: int, operand: int) -> int:
        """The operand at one of the samples 0 to ``last``."""
        if last == 0 or operand in (TRUE, FALSE):
            return operand
        if delay := self.delay(operand):
            return self.later(delay, self.eventually(last, self.later(-delay, operand)))
        node = self.nodes[operand]
        if isinstance(node, Eventually):
            return self._number(Eventually(last + node.last, node.operand))
        return self._number(Eventually(last, operand))

    def until(self, last: int, left: int, right: int) -> int:
        """``right`` at one of the samples 0 to ``last``, ``left`` at all before it."""
        if last == 0 or right in (TRUE, FALSE) or self.entails(left, right):
            return right
        if left == TRUE:
            return self.eventually(last, right)
        if delay := min(self.delay(left), self.delay(right)):
            return self.later(delay, self.until(last, self.later(-delay, left), self.later(-delay, right)))
        return self._number(Until(last, left, right))

    def always_in(self, start: int, end: int, operand: int) -> int:
        """The operand at samples ``start`` to ``end`` from now; true if there are none."""
        return TRUE if end < start else self.later(start, self.always(end - start, operand))

    def eventually_in(self, start: int, end: int, operand: int) -> int:
        """The operand at one of the samples ``start`` to ``end`` from now; false if there are none."""
        return FALSE if end < start else self.later(start, self.eventually(end - start, operand))

    def until_in(self, start: int, end: int, unasked: int, left: int, right: int) -> int:
        """``right`` at one of the samples ``start`` to ``end``, ``left`` from sample ``unasked`` up to before it.

        A witness before ``unasked`` asks nothing of ``left``; one from there on asks it of samples ``unasked`` on.
        """
        early = self.eventually_in(start, min(end, unasked - 1), right)
        start = max(start, unasked)
        if end < start:
            return early
        waiting = self.always_in(unasked, start - 1, left)
        witnessed = self.later(start, self.until(end - start, left, right))
        return self.disjunction([early, self.conjunction([waiting, witnessed])])

    def conjunction(self, obligations: Iterable[int]) -> int:
        """All of the obligations."""
        members = frozenset(obligations)
        key = (True, members)
        if (known := self._joined.get(key)) is None:
            known = self._joined[key] = self._conjunction(members)
        return known

    def disjunction(self, obligations: Iterable[int]) -> int:
        """One of the obligations, or more."""
        members = frozenset(obligations)
        key = (False, members)
        if (known := self._joined.get(key)) is None:
            known = self._joined[key] = self._disjunction(members)
        return known

    def copied_to(self, other: "Obligations") -> Callable[[int], int]:
        """A function from obligations to their numbers among ``other`` obligations, made there as needed."""

        @cache
        def copied(obligation: int) -> int:
            match self.nodes[obligation]:
                case Truth(value):
                    return TRUE if value else FALSE
                case Now(literal):
                    return other.now(literal)
                case All(members):
                    return other.conjunction(map(copied, members))
                case Some(members):
                    return other.disjunction(map(copied, members))
                case Always(last, operand):
                    return other.always(last, copied(operand))
                case Eventually(last, operand):
                    return other.eventually(last, copied(operand))
                case Until(last, left, right):
                    return other.until(last, copied(left), copied(right))
                case Later(delay, operand):
                    return other.later(delay, copied(operand))
            raise TypeError(f"obligation {obligation} is of no known kind")

        return copied

    def antichain(self, obligations: Iterable[int], *, weakest: bool) -> tuple[int, ...]:
        """The weakest of the obligations, or the strongest: none entails another. In the order of their numbers."""
        kept: list[int] = []
        for one in sorted(set(obligations)):
            # Of two that entail each other the first one stays.
            if not any(self._covers(other, one, weakest) for other in kept):
                kept = [other for other in kept if not self._covers(one, other, weakest)] + [one]
        return tuple(kept)

    def _covers(self, one: int, other: int, weakest: bool) -> bool:
        return self.entails(other, one) if weakest else self.entails(one, other)

    def _conjunction(self, obligations: frozenset[int]) -> int:
        if FALSE in obligations:
            return FALSE
        members = {part for obligation in obligations for part in self.parts(obligation)}
        strongest = self.antichain(self._merged(members, Always), weakest=False)
        if len(strongest) < 2:
            return strongest[0] if strongest else TRUE
        return self._number(All(strongest))

    def _disjunction(self, obligations: frozenset[int]) -> int:
        if TRUE in obligations:
            return TRUE
        members: set[int] = set()
        for obligation in obligations - {FALSE}:
            delay, node = 0, self.nodes[obligation]
            if isinstance(node, Later):
                delay, node = node.delay, self.nodes[node.operand]
            members |= {self.later(delay, part) for part in node.members} if isinstance(node, Some) else {obligation}
        weakest = self.antichain(self._merged(members, Eventually), weakest=True)
        if len(weakest) < 2:
            return weakest[0] if weakest else FALSE
        delay = min(map(self.delay, weakest))
        return self.later(delay, self._number(Some(tuple(sorted(self.later(-delay, part) for part in weakest)))))

    def _merged(self, members: set[int], kind: type[Always] | type[Eventually]) -> Iterable[int]:
        """The members, those windows of one operand joined that overlap or follow each other without a gap."""
        windows: dict[int, list[_Window]] = {}
        for member in members:
            delay = self.delay(member)
            operand = self.later(-delay, member)
            node = self.nodes[operand]
            if isinstance(node, kind):
                windows.setdefault(node.operand, []).append((delay, delay + node.last))
            else:
                windows.setdefault(operand, []).append((delay, delay))
        if len(windows) == len(members):
            return members
        join = self.always_in if kind is Always else self.eventually_in
        return [join(*window, operand) for operand, found in windows.items() for window in _joined(found)]

    def _number(self, node: Node) -> int:
        number = self._numbers.get(node)
        if number is None:
            number = self._numbers[node] = len(self.nodes)
            self.nodes.append(node)
        return number


def _joined(windows: list[_Window]) -> list[_Window]:
    joined: list[_Window] = []
    for start, end in sorted(windows):
        if joined and start <= joined[-1][1] + 1:
            joined[-1] = (joined[-1][0], max(joined[-1][1], end))
        else:
            joined.append((start, end))
    return joined
