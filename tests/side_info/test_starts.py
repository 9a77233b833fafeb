"""When a vehicle started."""

import pytest

from fleet_bus.messages import StateFlag
from side_info.starts import VehicleStart

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
