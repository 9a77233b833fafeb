"""When a vehicle started."""

import pytest

from fleet_bus.messages import StateFlag
from fleet_bus.writers import Source
from side_info.service.starts import LEAVE, PATIENCE, VehicleStart

NEW, HISTORY, NONE = StateFlag.NEW_TRAJECTORY, StateFlag.HISTORY, StateFlag.NONE


@pytest.mark.parametrize(
    ("samples", "time_zero"),
    [
        ([], None),
        ([(5, NEW | HISTORY), (6, HISTORY)], None),
        ([(5, NEW | HISTORY), (7, NONE), (8, NONE)], None),
        ([(5, NEW), (6, NONE)], 5),
        ([(3, NONE), (5, NEW), (6, NONE)], 5),
        ([(5, NEW), (6, NONE), (9, NEW | StateFlag.INPUT_MISSING)], 9),
        ([(5, NEW), (2, NEW)], 2),
        ([(7, NONE), (6, NONE)], None),
        ([(5, NEW), (9, NEW | HISTORY)], 5),
    ],
)
def test_time_zero(samples: list[tuple[int, StateFlag]], time_zero: int | None) -> None:
    start = VehicleStart()
    start.see((t, int(flags)) for t, flags in samples)
    assert start.time_zero == time_zero


FIRST, SECOND = Source("a", 1), Source("b", 2)


def test_what_another_source_puts_moves_no_time_zero() -> None:
    start = VehicleStart()
    assert start.take_in(FIRST, [(100, NEW)], 0.0)
    assert not start.take_in(SECOND, [(150, NEW)], 0.1)
    assert start.take_in(FIRST, [(200, NONE)], 0.2)
    assert not start.elapse(PATIENCE + 1.0)
    assert start.take_in(FIRST, [(300, NONE)], LEAVE + 1.0)
    assert (start.time_zero, start.held) == (100, [])


def test_an_agent_that_follows_another_begins_anew_with_what_was_held() -> None:
    start = VehicleStart()
    start.take_in(FIRST, [(100, NEW)], 0.0)
    assert not start.take_in(SECOND, [(500, NEW), (550, NONE)], 0.5)
    assert not start.elapse(PATIENCE)
    assert start.elapse(PATIENCE + 0.1)
    assert start.time_zero == 500
    assert start.take_in(SECOND, [(600, NONE)], PATIENCE + 0.2)
