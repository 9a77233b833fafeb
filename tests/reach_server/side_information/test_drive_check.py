"""When a drive that is known as a whole left its scenario, against what the formula says of each sample by itself."""

import numpy as np
import pytest

from fleet_bus.errors import ScenarioError, UsageError
from reach_server.side_information import first_contradiction
from tests.reach_server.scenarios import PROFILE, scenario

START = 10**18
STEP = PROFILE.sample_time_ns


def drive(x1: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> tuple[np.ndarray, np.ndarray]:
    """Stamps and states of which only east, the x1 of scenarios, moves."""
    x = np.zeros((len(x1), 3))
    x[:, 1] = x1
    return START + np.arange(len(x1)) * STEP, x


@pytest.mark.parametrize("seed", range(20))
def test_the_first_sample_that_breaks_what_always_holds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    t, x = drive(rng.uniform(-1.0, 1.05, 40))
    # Samples every 0.1 s: the window holds those of 1 s to 3 s.
    bad = [k for k in range(10, 31) if x[k, 1] > 1.0]
    found = first_contradiction(scenario("always[1:3 s](x1 <= 1)"), PROFILE, t, x)
    assert found == (pytest.approx(bad[0] * STEP / 1e9) if bad else None)


@pytest.mark.parametrize("reached", [None, 3, 20, 21])
def test_what_should_happen_has_not_when_its_window_ends(reached: int | None) -> None:
    x1 = np.zeros(40)
    if reached is not None:
        x1[reached] = 2.0
    found = first_contradiction(scenario("eventually[0:2 s](x1 >= 1)"), PROFILE, *drive(x1))
    assert found == (None if reached in (3, 20) else pytest.approx(2.0))


def test_time_zero_may_be_handed_in_and_what_comes_before_does_not_count() -> None:
    x1 = np.zeros(40)
    x1[[2, 12]] = 2.0
    side, (t, x) = scenario("always[0:9 s](x1 <= 1)"), drive(x1)
    assert first_contradiction(side, PROFILE, t, x) == pytest.approx(0.2)
    assert first_contradiction(side, PROFILE, t, x, START + 5 * STEP) == pytest.approx(0.7)
    assert first_contradiction(side, PROFILE, t, x, START + 100 * STEP) is None
    assert first_contradiction(side, PROFILE, t[:0], x[:0]) is None


def test_what_is_no_drive_is_refused() -> None:
    side, (t, x) = scenario("always[0:9 s](x1 <= 1)"), drive(np.zeros(5))
    with pytest.raises(UsageError, match=r"expected \(T,\) and \(T, 3\)"):
        first_contradiction(side, PROFILE, t, x[:, :2])
    with pytest.raises(UsageError, match="no drive"):
        first_contradiction(side, PROFILE, t[:4], x)
    with pytest.raises(UsageError, match="not finite"):
        first_contradiction(side, PROFILE, t, np.where(x == 0, np.nan, x))
    with pytest.raises(UsageError, match="oldest first"):
        first_contradiction(side, PROFILE, t[::-1], x)
    fits_not = scenario("always[0:9 s](x1 <= 1)")
    with pytest.raises(ScenarioError):
        first_contradiction(
            fits_not, PROFILE.model_copy(update={"state": {"z": next(iter(PROFILE.state.values()))}}), t, x[:, :1]
        )
