"""What a lint finds, and that what it calls impossible is."""

import random

import pytest

from side_info import Declarations, Formula, Scenario, ScenarioError, shipped
from side_info.documents.lint import MANY_PREDICATES, lint
from side_info.documents.satisfiability import conflicts, impossible
from side_info.stl.normal_form import NormalForms
from tests.side_info.corpus import DOCUMENT
from tests.side_info.evaluator import holds

HEAD = """\
scenario: lot
version: 1
state: {x1: m, x2: m}
time: {zero: on_start}
regions:
  P: {box: {x1: [0, 1], x2: [0, 1]}}
  D: {disc: {center: {x1: 0, x2: 0}, radius: 2}}
assume: G[0:1](D or P)
monitor:
"""


def found(assume: str, sample_time: float | None = None) -> list[str]:
    """Findings about a formula, without those about names that are not used."""
    scenario = Scenario.parse(f"{HEAD}  a: {assume!r}\n")
    return [str(finding) for finding in lint(scenario, sample_time) if "is not used" not in finding.message]


@pytest.mark.parametrize(
    ("formula", "column", "words"),
    [
        ("G[0:2](P) and G[2:3](D)", 21, "the window touches that of always[0:2](P) at 2 s"),
        ("G[2:3](D) and F[0:9](P) and G[0:2](P)", 7, "touches that of always[0:2](P) at 2 s"),
        ("P and not P", 7, "can never hold: at 0 s no state satisfies P and not P"),
        ("G[0:2](P and x1 >= 3)", 7, "can never hold: from 0 s to 2 s no state satisfies P and x1 >= 3"),
        ("G[0:2](x1 <= 1) and G[1:3](x1 - x2 >= 3 and x2 > -1)", 7, "can never hold: from 1 s to 2 s"),
        ("G[0:9](x1 <= 1) and F[2:3](D and x1 >= 1.5)", 7, "can never hold: from 2 s to 3 s"),
        ("G[0:9](D) and F[2:3](x1 >= 1.5 and x2 >= 1.5)", 7, "can never hold: from 2 s to 3 s"),
        ("G[0:9](not D -> x1 >= 3) and F[1:1](P and not D)", 7, "can never hold: at 1 s"),
        ("x1 >= 3 U[1:2] P", 7, "can never hold: from 1 s to 2 s"),
        ("(x1 >= 3 or x2 >= 3) and P", 7, "can never hold: at 0 s"),
        ("2 <= 1", 7, "can never hold"),
        ("D and (P or not P)", 14, "P or not P holds always"),
        ("F[0:2](P -> P) and G[1:2](D)", 7, "eventually[0:2](P -> P) holds always"),
        ("1 <= 2", 7, "1 <= 2 holds always"),
        ("x1 - x1 <= 0", 7, "holds always"),
        ("not (F[0:2](P) and G[0:4](not P))", 7, "holds always"),
    ],
)
def test_findings(formula: str, column: int, words: str) -> None:
    texts = found(formula)
    assert any(text.startswith(f"10:{column}: ") and words in text for text in texts), texts


@pytest.mark.parametrize(
    "formula",
    [
        "G[0:2](P) and G[2:3](P)",
        "G[0:2](P) and G[2.1:3](D)",
        "G[0:2](P) or G[2:3](D)",
        "G[0:1](P) and G[1.5:3](not P)",
        "F[0:9](P) and F[0:9](not P)",
        "G[0:9](x1 <= 1 or x2 >= 0) and F[2:3](D and x1 >= 1.5)",
        "F[0:9](D and not P)",
        "G[0:2](x1*x2 >= 3) and G[0:2](x1*x2 <= 2)",
    ],
)
def test_what_is_not_found(formula: str) -> None:
    assert found(formula) == []


@pytest.mark.parametrize(
    ("formula", "words"),
    [
        ("G[0.01:0.04](P)", "the window [0.01:0.04] of 'always' holds no sample (one sample every 0.05 s): it says"),
        ("F[0.01:0.04](P)", "the window [0.01:0.04] of 'eventually' holds no sample (one sample every 0.05 s): it can"),
        ("P U[0.06:0.09] D", "of 'until' holds no sample (one sample every 0.05 s): it can never hold"),
        ("G[0.04:0.06](D)", "the window [0.04:0.06] of 'always' is narrower than a sample time"),
        ("G[0:9](F[1:1](D))", "the window [1:1] of 'eventually' is narrower than a sample time"),
    ],
)
def test_windows_and_the_grid(formula: str, words: str) -> None:
    assert any(words in text for text in found(formula, 0.05))
    assert found(formula) == []


def test_windows_that_hold_samples() -> None:
    assert found("G[0:0](D) and F[0.05:0.1](P) and G[0.1:0.15](D)", 0.05) == []
    # Without a sample between them there is no contradiction.
    assert found("G[0.01:0.04](P and not P)", 0.05) == [
        "10:7: the window [0.01:0.04] of 'always' holds no sample (one sample every 0.05 s): it says nothing"
    ]


def test_names_that_are_not_used() -> None:
    text = DOCUMENT.replace("r - abs(x2 + 1.5) >= 0", "D").replace("always[0:1](P)", "always[0:5 s](P)")
    text = text.replace("r: 1.5", "r: 1.5, s: 3").replace("assume:", "  R: P and s*x1 >= 0\nassume:")
    assert [str(finding) for finding in lint(Scenario.parse(text)) if "not used" in finding.message] == [
        "5:23: the parameter 'r' is not used",
        "10:3: the region 'R' is not used",
    ]


@pytest.mark.parametrize("name", shipped())
def test_what_ships_can_hold(name: str) -> None:
    assert not [finding for finding in lint(Scenario.load(name), 0.05) if "touches" not in finding.message]


@pytest.mark.slow
def test_what_is_called_impossible_is() -> None:
    """Random formulas of strips and discs: where a conflict is found, no sampled state or trace satisfies them."""
    chance = random.Random(7)
    declared = Declarations(("x1", "x2"))

    def comparison() -> str:
        at = chance.randint(-4, 4) / 2
        terms = ["x1", "x2", "x1 + x2", "x1 - 2*x2", "abs(x1)", "norm(x1 - 1, x2)", "max(x1, x2)"]
        return f"{chance.choice(terms)} {chance.choice(['<=', '>='])} {at}"

    def boolean(depth: int) -> str:
        if not depth:
            return f"({comparison()})"
        one, other = boolean(depth - 1), boolean(depth - 1)
        return chance.choice([f"(not {one})", f"({one} and {other})", f"({one} or {other})", f"({one} -> {other})"])

    def timed() -> str:
        start = chance.randint(0, 3)
        window = f"[{start}:{start + chance.randint(0, 3)}]"
        kinds = [f"G{window}{boolean(1)}", f"F{window}{boolean(1)}", f"({boolean(1)} U{window}{boolean(1)})"]
        return chance.choice([boolean(1), *kinds])

    certain = 0
    for _ in range(700):
        text = " and ".join(timed() for _ in range(chance.randint(1, 4)))
        formula = Formula.parse(text if chance.random() < 0.7 else f"not ({text})", declared)
        for sign in (True, False):
            try:
                conflict = next(conflicts(formula, NormalForms(), holds=sign), None)
            except ScenarioError:
                continue
            if conflict is None:
                continue
            certain += 1
            for _ in range(12):
                trace = [{"x1": chance.randint(-6, 6) / 2, "x2": chance.randint(-6, 6) / 2} for _ in range(8)]
                assert holds(formula, trace) != sign, text
    assert certain > 50


def test_a_formula_about_time_zero_only_is_told() -> None:
    assert found("x1 <= 1 and D") == [
        "10:7: x1 <= 1 and D has no always, eventually or until: it speaks about time zero only"
    ]


def test_many_predicates_are_told() -> None:
    terms = " and ".join(f"x1 + {k}*x2 >= -{k + 1}" for k in range(MANY_PREDICATES))
    text = HEAD.replace("D or P", terms) + '  a: "G[0:1](x1 <= 7)"\n'
    messages = [str(finding) for finding in lint(Scenario.parse(text))]
    # A requirement counts with its negation.
    assert any(message.startswith("8:1: 66 predicates: each one costs time at every sample") for message in messages)


@pytest.mark.parametrize("sample_time", [0.0, -1.0, float("nan"), float("inf")])
def test_a_sample_time_that_is_none_is_refused(sample_time: float) -> None:
    with pytest.raises(ScenarioError, match="a sample time of"):
        lint(Scenario.parse(DOCUMENT), sample_time)


@pytest.mark.slow
def test_many_alternatives_are_given_up() -> None:
    text = " and ".join(f"(x1 >= {k} or x2 >= {k})" for k in range(30)) + " and x1 <= -1 and x2 <= -1"
    formula = Formula.parse(text, Declarations(("x1", "x2")))
    assert impossible([(formula, True)], NormalForms()) is None
