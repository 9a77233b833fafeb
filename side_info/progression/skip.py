"""Obligations after samples that nothing is known of, in closed form: many steps at once.

An obligation is monotone in its literals, so that what may be left of it after unknown samples is what is left if all
literals held there. With r the samples that an obligation looks ahead, it has come true n > r samples later; so of an
``always`` or ``eventually`` only the last r of its past instances still ask for something.
"""

from typing import Final

from side_info.progression.nodes import FALSE, TRUE, All, Always, Eventually, Later, Now, Some, Truth, Until
from side_info.progression.obligations import Obligations

#: Past instances that are kept track of; beyond them what is left is weakened.
MOST_INSTANCES: Final = 256


class Elapsing:
    """``after(obligation, n)``: what is left of an obligation, n unknown samples later; exact up to
    ``MOST_INSTANCES`` instances of one operator, weaker beyond."""

    def __init__(self, obligations: Obligations) -> None:
        self._build = obligations
        self._known: dict[tuple[int, int], int] = {}
        self._reaches: dict[int, int] = {}

    def after(self, obligation: int, steps: int) -> int:
        """What is left after ``steps`` samples at which every literal may have held."""
        if steps <= 0 or obligation in (TRUE, FALSE):
            return obligation
        if steps > self._reach(obligation):
            return TRUE
        key = (obligation, steps)
        if (known := self._known.get(key)) is None:
            known = self._known[key] = self._after(obligation, steps)
        return known

    def _after(self, obligation: int, steps: int) -> int:
        build, node = self._build, self._build.nodes[obligation]
        match node:
            case All(members):
                return build.conjunction([self.after(member, steps) for member in members])
            case Some(members):
                return build.disjunction([self.after(member, steps) for member in members])
            case Later(delay, operand):
                return self.after(operand, steps - delay) if steps >= delay else build.later(delay - steps, operand)
            case Always(last, operand):
                past = range(max(0, steps - self._reach(operand)), min(last, steps - 1) + 1)[-MOST_INSTANCES:]
                left = [self.after(operand, steps - j) for j in past]
                return build.conjunction([*left, build.always(last - steps, operand)] if last >= steps else left)
            case Eventually(last, operand):
                return self._until(last, TRUE, operand, steps)
            case Until(last, left_operand, right):
                return self._until(last, left_operand, right, steps)
        return TRUE

    def _until(self, last: int, left: int, right: int, steps: int) -> int:
        build = self._build
        if min(last + 1, steps) > MOST_INSTANCES and self.after(right, steps) != TRUE:
            return TRUE
        ways, kept = [], TRUE
        for witness in range(min(last, steps - 1) + 1):
            ways.append(build.conjunction((kept, self.after(right, steps - witness))))
            if ways[-1] == TRUE:
                return TRUE
            kept = build.conjunction((kept, self.after(left, steps - witness)))
        if last >= steps:
            ways.append(build.conjunction((kept, build.until(last - steps, left, right))))
        return build.disjunction(ways)

    def _reach(self, obligation: int) -> int:
        """Index of the last sample that matters to the obligation."""
        if (known := self._reaches.get(obligation)) is None:
            known = self._reaches[obligation] = self._looked(obligation)
        return known

    def _looked(self, obligation: int) -> int:
        match self._build.nodes[obligation]:
            case Truth() | Now():
                return 0
            case All(members) | Some(members):
                return max(map(self._reach, members))
            case Always(last, operand) | Eventually(last, operand):
                return last + self._reach(operand)
            case Until(last, left, right):
                return last + max(self._reach(left), self._reach(right))
            case Later(delay, operand):
                return delay + self._reach(operand)
        raise TypeError(f"obligation {obligation} is of no known kind")
