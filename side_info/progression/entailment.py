"""Which obligation certainly asks for no less than another: a structural, one-sided test.

``entails`` true means: every sequence of samples that fulfils the one fulfils the other. False means nothing.
All rules speak about ``(delay, node)``, a node that is to hold ``delay`` samples from now, and are invariant under
a common shift, so the smaller delay is taken off before a pair is looked up.
"""

from collections.abc import Sequence

from side_info.progression.nodes import FALSE, TRUE, All, Always, Eventually, Later, Node, Some, Until


class Entailment:
    """The test, memoised over ``nodes``, a list of hash-consed nodes that may grow."""

    def __init__(self, nodes: Sequence[Node]) -> None:
        self._nodes = nodes
        self._known: dict[tuple[int, int, int, int], bool] = {}

    def __call__(self, first: int, second: int) -> bool:
        return self._entails(0, first, 0, second)

    def _entails(self, n: int, x: int, m: int, y: int) -> bool:
        """Whether node x in n samples entails node y in m samples."""
        if x == FALSE or y == TRUE:
            return True
        if x == TRUE or y == FALSE:
            return False
        first, second = self._nodes[x], self._nodes[y]
        if isinstance(first, Later):
            n, x = n + first.delay, first.operand
        if isinstance(second, Later):
            m, y = m + second.delay, second.operand
        if x == y and n == m:
            return True
        shift = min(n, m)
        key = (n - shift, x, m - shift, y)
        known = self._known.get(key)
        if known is None:
            known = self._known[key] = self._decide(*key)
        return known

    def _decide(self, n: int, x: int, m: int, y: int) -> bool:
        first, second = self._nodes[x], self._nodes[y]
        # To entail all is to entail each, and to be entailed by one of several is to be entailed by each.
        if isinstance(second, All):
            return all(self._entails(n, x, m, part) for part in second.members)
        if isinstance(first, Some):
            return all(self._entails(n, part, m, y) for part in first.members)
        if isinstance(first, All) and any(self._entails(n, part, m, y) for part in first.members):
            return True
        if isinstance(second, Some) and any(self._entails(n, x, m, part) for part in second.members):
            return True
        return self._temporal_first(n, first, m, y) or self._temporal_second(n, x, m, second)

    def _temporal_first(self, n: int, first: Node, m: int, y: int) -> bool:
        second = self._nodes[y]
        match first, second:
            case Always(), Always() if n <= m and m + second.last <= n + first.last:
                if self._entails(0, first.operand, 0, second.operand):
                    return True
            case Eventually(), Eventually() if m <= n and n + first.last <= m + second.last:
                if self._entails(0, first.operand, 0, second.operand):
                    return True
            case Until(), Eventually() if m <= n and n + first.last <= m + second.last:
                if self._entails(0, first.right, 0, second.operand):
                    return True
            case Until(), Until() if n == m and first.last <= second.last:
                if self._entails(0, first.left, 0, second.left) and self._entails(0, first.right, 0, second.right):
                    return True
        if isinstance(first, Always):
            # The operand holds at each sample of the window: the one nearest to what is asked for serves best.
            return self._entails(n + _nearest(m - n, first.last), first.operand, m, y)
        if isinstance(first, Until):
            # One of the two holds now.
            return self._entails(n, first.right, m, y) and self._entails(n, first.left, m, y)
        return False

    def _temporal_second(self, n: int, x: int, m: int, second: Node) -> bool:
        if isinstance(second, Eventually):
            # Witnessed by x itself, at the sample of the window that is nearest to it.
            return self._entails(n, x, m + _nearest(n - m, second.last), second.operand)
        if isinstance(second, Until):
            return self._entails(n, x, m, second.right)
        return False


def _nearest(sample: int, last: int) -> int:
    return min(max(sample, 0), last)
