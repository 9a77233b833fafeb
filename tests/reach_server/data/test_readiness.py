"""What is said to be missing is what it takes."""

import numpy as np
import pytest

from reach_server.data.readiness import samples_missing, too_few
from reach_server.data.window import Window
from tests.reach_server.data.circles import circle, profile

ALL = np.array([0])


def usable(window: Window, links: int) -> int:
    """Samples held that enough links in a row lead to."""
    held = int(window.filled(ALL)[0])
    return int((window.arrays().run[0, :held] >= links).sum())


@pytest.mark.parametrize("links", [1, 4])
@pytest.mark.parametrize("gap", [None, 0, 3, 9, 10])
def test_after_as_many_samples_there_is_enough_and_not_before(links: int, gap: int | None) -> None:
    window = Window(profile(), 100)
    window.grow(1)
    for k in range(gap or 0):
        window.append(circle(1, k))
    start = 0 if gap is None else gap + 5
    first = int(samples_missing(window, ALL, np.array([usable(window, links)]), 10, links)[0])
    if gap:
        # The gap itself is not foreseen: the links have to be made anew.
        window.append(circle(1, start))
        start += 1
    missing = int(samples_missing(window, ALL, np.array([usable(window, links)]), 10, links)[0])
    assert missing >= first - 1
    for k in range(missing):
        assert usable(window, links) < 10
        window.append(circle(1, start + k))
    assert usable(window, links) == 10 or missing == 0
    assert samples_missing(window, ALL, np.array([usable(window, links)]), 10, links)[0] == 0


def test_the_text_names_the_method_and_the_number() -> None:
    assert too_few("calibrated", 12) == "too few samples for calibrated: at least 12 more"
