"""Windows in whole nanoseconds."""

import pytest

from side_info import ScenarioError
from side_info.stl.windows import check_window, window_ns


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        (0.0, 25.0, (0, 25 * 10**9)),
        (0.29, 0.57, (290_000_000, 570_000_000)),
        (0.1 + 0.2, 0.4, (300_000_000, 400_000_000)),
        (9 * 1e-3, 1.0, (9_000_000, 10**9)),
        (1.5e-9, 2.5e-9, (2, 2)),
        (123456789.123456789, 1e9, (123456789123456790, 10**18)),
    ],
)
def test_windows_in_nanoseconds(start: float, end: float, expected: tuple[int, int]) -> None:
    assert window_ns(start, end) == expected


@pytest.mark.parametrize(
    ("start", "end", "words"),
    [
        (2.0, 1.0, "reversed: 2 s > 1 s"),
        (-1.0, 1.0, "a bound of -1 s"),
        (0.0, 2e9, "expected 0 to 1e.09 s"),
        (0.0, float("nan"), "a bound of nan s"),
        (0.1e-9, 0.9e-9, "no whole nanosecond"),
    ],
)
def test_what_is_no_window(start: float, end: float, words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        check_window(start, end)
