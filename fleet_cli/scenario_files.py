"""Scenario documents by name or path: what each says, and what is remarkable about it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fleet_bus.errors import ScenarioError
from fleet_bus.messages import VehicleProfile
from side_info.documents.lint import Finding, lint
from side_info.documents.scenario import Scenario, shipped
from side_info.stl.normal_form import literals_in
from side_info.stl.predicates import DiscPredicate, LinearPredicate, Predicate


@dataclass(frozen=True, slots=True)
class Checked:
    """A document that checks, the file that it came from, and what lint finds in it."""

    source: str
    scenario: Scenario
    findings: tuple[Finding, ...]


def check(
    names: Sequence[str], profile: VehicleProfile | None, sample_time: float | None
) -> tuple[list[Checked], list[ScenarioError]]:
    """Load shipped scenarios or files, in that order; those that do not check, or do not fit ``profile``, are errors.

    Lint takes ``sample_time`` (s), else the profile's.
    """
    if sample_time is None and profile is not None:
        sample_time = profile.sample_time
    checked, errors = [], []
    for name in names:
        try:
            scenario = Scenario.load(name)
            if profile is not None:
                scenario.state_indices(profile)
            source = f"{name}.yaml" if name in shipped() else name
            checked.append(Checked(source, scenario, lint(scenario, sample_time)))
        except ScenarioError as error:
            errors.append(error)
    return checked, errors


def describe(scenario: Scenario) -> str:
    """The first line of comment of the document, else what it holds."""
    first = next(iter(scenario.text.splitlines()), "").strip()
    return first.lstrip("# ").rstrip(".") if first.startswith("#") else summarize(scenario)


def summarize(scenario: Scenario) -> str:
    """What the side information of a scenario comes to, in one line."""
    predicates, monitors = len(set(literals_in(scenario.side_information))), len(scenario.monitor)
    line = f"{predicates} predicate{'s' * (predicates != 1)} over {scenario.end_ns / 1e9:g} s"
    return line + (f", {monitors} monitor{'s' * (monitors != 1)}" if monitors else "")


def place(checked: Checked, finding: Finding) -> str:
    """Where a finding stands, for a line of text."""
    return f"{checked.source}:{finding.line}:{finding.column}"


def as_json(checked: Sequence[Checked], errors: Sequence[ScenarioError] = ()) -> dict[str, Any]:
    """What ``fleet scenario check --json`` writes."""
    return {
        "scenarios": [
            {
                "source": one.source,
                "scenario": one.scenario.name,
                "version": one.scenario.version,
                "description": describe(one.scenario),
                "state": dict(one.scenario.state),
                "predicates": [
                    one.scenario.predicates[index].name
                    for index in sorted(set(literals_in(one.scenario.side_information)))
                ],
                "assume": str(one.scenario.assume),
                "monitor": {name: str(formula) for name, formula in one.scenario.monitor.items()},
                "end": one.scenario.end_ns / 1e9,
                "warnings": [
                    {"message": finding.message, "line": finding.line, "column": finding.column}
                    for finding in one.findings
                ],
            }
            for one in checked
        ],
        "errors": [str(error) for error in errors],
    }


def predicate_text(predicate: Predicate) -> str:
    """A predicate as a comparison."""
    match predicate:
        case LinearPredicate(_, coefficients, lower, upper):
            value = " + ".join(name if c == 1 else f"{c:g} {name}" for name, c in coefficients.items())
            value = value.replace("+ -", "- ")
            left = f"{lower:g} <= " if np.isfinite(lower) else ""
            right = f" <= {upper:g}" if np.isfinite(upper) else ""
            return f"{value} >= {lower:g}" if not right else f"{left}{value}{right}"
        case DiscPredicate(_, center, radius):
            point = ", ".join(f"{value:g}" for value in center.values())
            return f"|({', '.join(center)}) - ({point})| <= {radius:g}"
    return f"{predicate.expression} >= 0"
