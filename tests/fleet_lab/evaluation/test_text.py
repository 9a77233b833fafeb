"""Mean and median of areas, side by side, and what is said where they differ by orders of magnitude."""

import pytest

from fleet_lab.evaluation import MethodFigures, StepFigures
from fleet_lab.evaluation.text import evaluation_lines


def lines_of(*steps: StepFigures) -> list[str]:
    figures = MethodFigures(steps, 1.0, 1.0, {}, (), (), (), {})
    return [line for line in evaluation_lines({"calibrated": figures}) if "area" in line]


def test_mean_and_median_of_the_first_and_the_last_step_are_told() -> None:
    found = lines_of(*(StepFigures(h, 100, 99, 2.0 * h, 1.0 * h) for h in (1, 2, 3)))
    assert found == ["  area, mean and median: 2 and 1 at step 1; 6 and 3 at step 3"]


@pytest.mark.parametrize(("median", "times"), [(1e-6, "6.7e+06 times"), (0.0, "infinitely many times")])
def test_orders_of_magnitude_between_them_are_told(median: float, times: str) -> None:
    found = lines_of(StepFigures(1, 100, 99, 2.0, 1.0), StepFigures(2, 100, 99, 6.7, median))
    assert len(found) == 2
    assert f"orders of magnitude: at step 2 the mean is {times} the median" in found[1]
    assert "at 1 of 2 steps" in found[1]


def test_steps_that_were_not_checked_say_nothing() -> None:
    assert lines_of(StepFigures(1, 0, 0, 0.0, 0.0)) == []
    assert len(lines_of(StepFigures(1, 9, 9, 1.0, 1.0), StepFigures(2, 0, 0, 0.0, 0.0))) == 1
