"""What is suspicious in a scenario that is otherwise sound."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Final

from lark import Token, Tree

from fleet_bus.errors import ScenarioError
from side_info.documents.document import ScenarioFields, read_fields
from side_info.documents.satisfiability import Conflict, conflicts, window_text
from side_info.documents.scenario import Scenario
from side_info.documents.scenario_text import Found, ScenarioText
from side_info.documents.source_location import Excerpt, line_and_column
from side_info.documents.yaml_text import YamlText, read_yaml
from side_info.stl.ast import Always, And, Eventually, Formula, Temporal, Until, formulas_in
from side_info.stl.expression import number_text
from side_info.stl.normal_form import NormalForms
from side_info.stl.parser import syntax_tree
from side_info.stl.windows import window_ns

#: Predicates in use beyond which their number is worth a word.
MANY_PREDICATES: Final = 64


@dataclass(frozen=True, slots=True)
class Finding:
    """Something to look at, at a line and column (from 1) of the scenario's text."""

    message: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.line}:{self.column}: {self.message}"


def lint(scenario: Scenario, sample_time: float | None = None) -> tuple[Finding, ...]:
    """Findings in the order of the text.

    ``sample_time`` (s) is that of the vehicles, where it is known; without it, and under continuous semantics, nothing
    is said about windows that hold no sample. What is said never to hold, or always to hold, surely does so; not
    everything of the kind is found. Raises ``ScenarioError`` for a sample time that is none.
    """
    document = read_yaml(scenario.text, scenario.name)
    fields = read_fields(document)
    text = ScenarioText.of(fields, document)
    if sample_time is not None and not 1e-9 <= sample_time <= 1e9:
        raise ScenarioError(f"a sample time of {sample_time:g} s: expected 1e-9 to 1e+09 s")
    gridded = sample_time if scenario.semantics == "sampled" else None
    step_ns = None if gridded is None else round(gridded * 1e9)
    findings = [*_unused(fields, text, document), *_many(scenario, document)]
    for found in (text.assume, *text.monitor.values()):
        findings += _touching(found)
        findings += _timeless(found)
        findings += _extremes(found, text.forms, step_ns)
        if step_ns is not None:
            findings += _off_grid(found, step_ns)
    return tuple(sorted(dict.fromkeys(findings), key=lambda finding: (finding.line, finding.column, finding.message)))


def _finding(excerpt: Excerpt, formula: Formula, message: str) -> Finding:
    return Finding(message, *excerpt.place(formula.at))


def _unused(fields: ScenarioFields, text: ScenarioText, document: YamlText) -> Iterator[Finding]:
    """Regions that neither side information nor a requirement leads to, and parameters that no text names."""
    named = {name: _names(found.excerpt) for name, found in text.regions.items()}
    used = set().union(*(_names(found.excerpt) for found in (text.assume, *text.monitor.values())))
    everywhere = used.union(*named.values())
    for name in reversed(list(fields.regions)):
        if name in used:
            used |= named.get(name, set())
    for kind, declared, names in (("parameters", fields.parameters, everywhere), ("regions", fields.regions, used)):
        for name in declared:
            if name not in names:
                place = line_and_column(document.text, document.keys[kind, name].start_mark.index)
                yield Finding(f"the {kind.removesuffix('s')} {name!r} is not used", *place)


def _names(excerpt: Excerpt) -> set[str]:
    tree = syntax_tree(excerpt)
    tokens = tree.scan_values(lambda token: isinstance(token, Token)) if isinstance(tree, Tree) else iter((tree,))
    return {str(token) for token in tokens if token.type == "NAME"}


def _timeless(found: Found) -> Iterator[Finding]:
    formula = found.formula
    if not any(isinstance(part, Temporal) for part in formulas_in(formula)):
        yield _finding(
            found.excerpt,
            formula,
            f"{formula!s:.60} has no always, eventually or until: it speaks about time zero only",
        )


def _many(scenario: Scenario, document: YamlText) -> Iterator[Finding]:
    count = len(scenario.used)
    if count > MANY_PREDICATES:
        place = line_and_column(document.text, document.keys[("assume",)].start_mark.index)
        message = f"{count} predicates: each one costs time at every sample, for all vehicles of its server"
        yield Finding(message, *place)


def _touching(found: Found) -> Iterator[Finding]:
    for formula in formulas_in(found.formula):
        if not isinstance(formula, And):
            continue
        windows = [part for part in formula.operands if isinstance(part, Always)]
        for one, other in combinations(windows, 2):
            first, second = sorted((one, other), key=lambda window: (window.start, window.end))
            if first.end == second.start and first.operand != second.operand:
                yield _finding(
                    found.excerpt,
                    second,
                    f"the window touches that of {first!s:.60} at {number_text(second.start)} s, where both hold: "
                    "a time stamp that is wrong by a sample time can leave no state",
                )


def _extremes(found: Found, forms: NormalForms, step_ns: int | None) -> Iterator[Finding]:
    """What can never hold, and parts that always do."""
    conflict = _first(found.formula, forms, step_ns, holds=True)
    if conflict is not None:
        where = window_text(conflict.start, conflict.end)
        yield _finding(
            found.excerpt, found.formula, f"can never hold: {where} no state satisfies {conflict.words:.200}"
        )
    for part in found.formula.operands if isinstance(found.formula, And) else (found.formula,):
        if _first(part, forms, step_ns, holds=False) is not None:
            yield _finding(found.excerpt, part, f"{part!s:.60} holds always: it says nothing")


def _first(formula: Formula, forms: NormalForms, step_ns: int | None, *, holds: bool) -> Conflict | None:
    """First conflict on a window that has a sample, as far as that is known."""
    for conflict in conflicts(formula, forms, holds=holds):
        start_ns, end_ns = window_ns(conflict.start, conflict.end)
        if step_ns is None or _has_sample(start_ns, end_ns, step_ns):
            return conflict
    return None


def _off_grid(found: Found, step_ns: int) -> Iterator[Finding]:
    every = f"one sample every {number_text(step_ns / 1e9)} s"
    for formula in formulas_in(found.formula):
        if not isinstance(formula, Temporal):
            continue
        start_ns, end_ns = window_ns(formula.start, formula.end)
        word = type(formula).__name__.lower()
        if not _has_sample(start_ns, end_ns, step_ns):
            effect = "can never hold" if isinstance(formula, Eventually | Until) else "says nothing"
            message = f"the window {formula.window} of '{word}' holds no sample ({every}): it {effect}"
            yield _finding(found.excerpt, formula, message)
        elif end_ns - start_ns < step_ns and end_ns > 0:
            message = (
                f"the window {formula.window} of '{word}' is narrower than a sample time ({every}): "
                "whether a sample falls into it is a matter of timing"
            )
            yield _finding(found.excerpt, formula, message)


def _has_sample(start_ns: int, end_ns: int, step_ns: int) -> bool:
    return -(-start_ns // step_ns) * step_ns <= end_ns
