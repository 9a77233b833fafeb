"""What a calibration says to be wary of, and what it says where nothing could be predicted."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from fleet_lab.evaluation import MethodFigures, RunFigures, StepFigures
from fleet_lab.identification.doubts import areas_apart, of_figures, too_little
from tests.fleet_lab.evaluation.test_evaluation_runs import PROFILE
from tests.fleet_lab.wavy import wavy


def figures(
    checked: int, inside: list[int], runs: Sequence[tuple[int, ...]], areas: tuple[float, float]
) -> MethodFigures:
    steps = tuple(StepFigures(h + 1, checked, held, *areas) for h, held in enumerate(inside))
    each = checked // len(runs)
    by_run = tuple(RunFigures("car", (i,), (each,) * len(run), run) for i, run in enumerate(runs))
    return MethodFigures(steps, 1.0, 1.0, {}, by_run, (), (), {})


def test_rates_as_stated_are_no_reason_for_doubt() -> None:
    assert of_figures({"calibrated": figures(200, [198, 200], [(99, 100), (99, 100)], (2.0, 1.0))}, 0.99, "m") == []


def test_a_step_below_the_rate_is_told() -> None:
    (text,) = of_figures({"calibrated": figures(1000, [991, 974], [(991, 990)], (2.0, 1.0))}, 0.99, "m")
    assert text.startswith("calibrated: 97.4 % of the states lie inside at step 2, below the 99 % stated")
    assert "1 of 2 steps are below; chance explains 0 of these" in text
    assert "give more recordings of such driving" in text


def test_a_run_below_the_rate_is_told_though_all_runs_together_are_not() -> None:
    (text,) = of_figures(
        {"calibrated": figures(5000, [4975, 4972], [(1000, 1000)] * 4 + [(995, 840)], (2, 1))}, 0.99, "m"
    )
    assert text.startswith("calibrated: the worst run is car run 4, 84.0 % at step 2 (1 of 5 runs are below 99 %")


def test_misses_that_chance_explains_are_told_as_such() -> None:
    (text,) = of_figures({"a": figures(1000, [985], [(985,)], (2.0, 1.0))}, 0.99, "m")
    assert "98.5 % of the states lie inside at step 1" in text
    assert "chance explains all, if misses came one by one" in text


def test_a_mean_area_orders_above_the_median_is_told() -> None:
    steps = (StepFigures(1, 9, 9, 2e-6, 1e-6), StepFigures(2, 9, 9, 6.7, 6e-6), StepFigures(3, 0, 0, 1e9, 1.0))
    text = areas_apart(steps, "m")
    assert "the mean area at step 2 is 6.7 m², 1.1e+06 times the median of 6e-06 m² (at 1 of 3 steps" in text
    assert areas_apart(steps[:1], "m") == ""
    assert areas_apart((StepFigures(1, 9, 9, 0.0, 0.0),), "m") == ""
    assert "far above the median of 0 m²" in areas_apart((StepFigures(1, 9, 9, 1.0, 0.0),), "m")
    (found,) = of_figures({"paper": figures(100, [100], [(100,)], (9.0, 0.1))}, 0.9, "m")
    assert found.startswith("paper: the mean area at step 1 is 9 m², 90 times the median")


@pytest.mark.parametrize("lags", [0, 3])
def test_samples_that_can_be_predicted_from_are_counted(lags: int) -> None:
    """Held against a count by hand, sample by sample."""
    rng = np.random.default_rng(4)
    steps = np.where(rng.random(400) < 0.3, 0.2, 0.05)
    one = wavy(401, runs=3)
    late = replace(
        one, t=np.concatenate([[0.0], np.cumsum(steps)]), u=np.where(rng.random((401, 1)) < 0.02, np.nan, one.u)
    )
    profile = PROFILE.model_copy(update={"input_lags": lags, "horizon": 4})
    reach = max(lags, 2)
    able = data = 0
    for k in range(401):
        for needed in (reach, reach + 4):
            window = range(k - needed + 1, k + 1)
            good = k >= needed and all(
                one.segment[i] == one.segment[i - 1] and steps[i - 1] == 0.05 and np.isfinite(late.u[i]).all()
                for i in window
            )
            able, data = able + (good and needed == reach), data + (good and needed != reach)
    text = too_little([late], profile)
    off = sum(steps[i - 1] != 0.05 for i in range(1, 401) if one.segment[i] == one.segment[i - 1])
    assert text.startswith(f"the sample intervals are too irregular: {off} of 398 are more than 30 % off 50 ms")
    assert f"of 401 samples {able} have the {reach} regular" in text
    assert f"and {data} the {reach + 4} that make a datum" in text
    assert "…" not in text


def test_a_short_recording_is_not_called_irregular() -> None:
    assert too_little([wavy(220)], PROFILE).startswith(
        "too few samples to predict any that is held out: of 220 samples"
    )
