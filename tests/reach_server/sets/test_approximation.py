"""Tags compose: exact changes nothing, outer and inner never meet."""

from itertools import product

import pytest

from reach_server.sets import Direction, SetError
from reach_server.sets.approximation import compose

EXACT, OUTER, INNER = Direction.EXACT, Direction.OUTER, Direction.INNER


def test_exact_steps_keep_the_direction() -> None:
    assert compose() is EXACT
    for direction in Direction:
        assert compose(direction) is direction
        assert compose(direction, EXACT) is compose(EXACT, direction) is direction
        assert compose(direction, direction) is direction


def test_composition_does_not_depend_on_the_order_of_steps() -> None:
    for steps in product(Direction, repeat=3):
        if {OUTER, INNER} <= set(steps):
            with pytest.raises(SetError, match="do not compose"):
                compose(*steps)
        else:
            first = compose(compose(steps[0], steps[1]), steps[2])
            assert compose(*steps) is first is compose(steps[0], compose(steps[1], steps[2]))
