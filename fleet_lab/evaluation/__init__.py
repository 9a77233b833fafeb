"""The engine offline over recordings: coverage, area and time, one method beside another."""

from fleet_lab.evaluation.document import as_json
from fleet_lab.evaluation.figures import MethodFigures, RunFigures, StepFigures
from fleet_lab.evaluation.method import INPUTS, Settings, evaluate
from fleet_lab.evaluation.trials import Trial, plan_trials

__all__ = [
    "INPUTS",
    "MethodFigures",
    "RunFigures",
    "Settings",
    "StepFigures",
    "Trial",
    "as_json",
    "evaluate",
    "plan_trials",
]
