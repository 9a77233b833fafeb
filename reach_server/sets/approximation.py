"""How a set relates to the true result of the operations that made it: exact, outer or inner."""

from enum import Enum

from reach_server.numeric.checks import SetError


class Direction(Enum):
    """``EXACT``: the true result up to rounding; ``OUTER``: it holds the true result; ``INNER``: it lies inside it."""

    EXACT = "exact"
    OUTER = "outer"
    INNER = "inner"


def compose(*directions: Direction) -> Direction:
    """The direction of a result whose operands and operation have these directions.

    An exact step keeps the direction, outer after outer is outer, inner after inner is inner. Raises ``SetError``
    where outer meets inner: what comes out bounds nothing.
    """
    met = {direction for direction in directions if direction is not Direction.EXACT}
    if len(met) > 1:
        raise SetError("an outer bound and an inner bound do not compose: the result would bound nothing")
    return met.pop() if met else Direction.EXACT
