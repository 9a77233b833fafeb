"""The engine offline over recordings: coverage, area and time, one method beside another."""

from fleet_cli.evaluation.document import as_json
from fleet_cli.evaluation.figures import MethodFigures, RunFigures, StepFigures
from fleet_cli.evaluation.method import INPUTS, Settings, evaluate
from fleet_cli.evaluation.trials import Trial, plan_trials

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
