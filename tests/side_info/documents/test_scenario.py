"""Scenario documents: what ships, what they come to, what is refused and where."""

import math
import pickle
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus.messages import VehicleProfile, parse_profile
from side_info import DiscPredicate, Formula, LinearPredicate, Requirement, Scenario, ScenarioError, shipped
from side_info.documents.document import instant_ns
from side_info.documents.yaml_text import MAX_BYTES
from side_info.stl.nnf import Conjunction, Disjunction, Finally, Globally, Literal
from side_info.stl.normal_form import literals_in
from tests.side_info.corpus import DOCUMENT, DOCUMENTS

SECOND = 10**9


def test_the_parking_lot_has_the_numbers_of_the_paper() -> None:
    scenario = Scenario.load("parking-lot")
    lower, upper, street = scenario.predicates[:3]
    assert (lower, upper, street) == (
        LinearPredicate("P.x1", {"x1": 1.0}, -1.437, 1.998),
        LinearPredicate("P.x2", {"x2": 1.0}, -1.59, 3.268),
        LinearPredicate("O", {"x2": 1.0}, -2.665, -0.665),
    )
    lot = Conjunction((Literal(0), Literal(1)))
    assert scenario.regions["P"] == lot
    assert scenario.side_information == Conjunction(
        (
            Globally(0, 25 * SECOND, lot),
            Finally(0, 25 * SECOND, Conjunction((Literal(0), Literal(1), Literal(2)))),
            Globally(25 * SECOND, 40 * SECOND, Literal(2)),
        )
    )
    # h1, h2, h5 as printed: half-width - |state + shift|
    for strip, half, shift in ((lower, 1.7175, -0.2805), (upper, 2.429, -0.839), (street, 1.0, 1.665)):
        assert isinstance(strip, LinearPredicate)
        assert (strip.lower, strip.upper) == pytest.approx((-shift - half, -shift + half), abs=1e-12)
    assert scenario.end_ns == 40 * SECOND
    assert scenario.time_zero is None


def test_the_roundabout_has_the_numbers_of_the_paper() -> None:
    scenario = Scenario.load("roundabout")
    assert scenario.side_information == Conjunction(
        (
            Globally(0, 4 * SECOND, Literal(0)),
            Globally(4 * SECOND, 10 * SECOND, Literal(1)),
            Globally(10 * SECOND, 14 * SECOND, Literal(2)),
        )
    )
    assert scenario.predicates[:3] == (
        LinearPredicate("B", {"x2": 1.0}, 1.25, 3.25),
        DiscPredicate("ring", {"x1": 0.307, "x2": 0.044}, 1.429),
        LinearPredicate("A", {"x2": 1.0}, -3.169, -1.169),
    )


@pytest.mark.parametrize("name", shipped())
def test_what_ships_is_named_as_its_file_and_reads_back(name: str) -> None:
    scenario = Scenario.load(name)
    assert scenario.name == name
    again = Scenario.parse(scenario.text)
    assert (again.predicates, again.assume) == (scenario.predicates, scenario.assume)
    assert (again.side_information, again.requirements) == (scenario.side_information, scenario.requirements)


def test_shipped_scenarios() -> None:
    assert {"parking-lot", "roundabout"} <= set(shipped())


def test_a_document_in_full() -> None:
    scenario = Scenario.parse(DOCUMENT, "lot.yaml")
    assert (scenario.name, scenario.version, scenario.text) == ("lot", 1, DOCUMENT)
    assert scenario.state == {"x1": "m", "x2": "m"}
    assert str(scenario.assume) == "always[0:25](P) and always[25:40](O)"
    assert {name: str(formula) for name, formula in scenario.monitor.items()} == {"stays": "always[0:1](P)"}
    assert (scenario.semantics, scenario.speed) == ("sampled", {})
    assert scenario.predicates == (
        LinearPredicate("P.x1", {"x1": 1.0}, -1.5, 2.0),
        LinearPredicate("P.x2", {"x2": 1.0}, -1.0, 3.0),
        DiscPredicate("D", {"x1": 0.0, "x2": 0.5}, 2.0),
        LinearPredicate("O", {"x2": 1.0}, -3.0, 0.0),
        LinearPredicate("not P#1", {"x1": 1.0}, -math.inf, -1.5),
        LinearPredicate("not P#2", {"x1": 1.0}, 2.0, math.inf),
        LinearPredicate("not P#3", {"x2": 1.0}, -math.inf, -1.0),
        LinearPredicate("not P#4", {"x2": 1.0}, 3.0, math.inf),
    )
    lot = Conjunction((Literal(0), Literal(1)))
    assert scenario.regions == {"P": lot, "D": Literal(2), "O": Literal(3)}
    assert scenario.side_information == Conjunction(
        (Globally(0, 25 * SECOND, lot), Globally(25 * SECOND, 40 * SECOND, Literal(3)))
    )
    outside = Disjunction(tuple(map(Literal, range(4, 8))))
    assert scenario.requirements == {"stays": Requirement(Globally(0, SECOND, lot), Finally(0, SECOND, outside))}
    assert scenario.used == (0, 1, 3, 4, 5, 6, 7)
    assert scenario.end_ns == 40 * SECOND
    assert isinstance(scenario.assume, Formula)


def test_what_knows_nothing_of_time_ends_at_once() -> None:
    assert Scenario.parse(DOCUMENT.replace("always[0:T](P) and\n  always[T:40 s](O)", "P or O")).end_ns == 0


def test_a_region_may_name_those_above_it() -> None:
    text = DOCUMENT.replace("assume:", "  Q: P and 0 <= x1 <= x2\n  R: not (P or D) -> x1 <= x2\nassume:")
    scenario = Scenario.parse(text)
    names = {name: [scenario.predicates[k].name for k in literals_in(form)] for name, form in scenario.regions.items()}
    assert names["Q"] == ["P.x1", "P.x2", "Q.3", "Q.4"]
    assert names["R"] == ["P.x1", "P.x2", "D", "Q.4"]


def test_equal_predicates_are_one_and_names_are_unique() -> None:
    text = DOCUMENT.replace("always[0:T](P)", "always[0:T](x1 >= -1.5 and -1.5 <= x1 <= 2 or not O and not in(O))")
    scenario = Scenario.parse(text)
    names = [predicate.name for predicate in scenario.predicates]
    assert len(set(names)) == len(names)
    assert names[4:7] == ["x1 >= -1.5", "not O#1", "not O#2"]
    assert next(literals_in(scenario.side_information)) == 4
    assert 0 in scenario.used


def test_an_explosion_of_regions_is_refused() -> None:
    regions = "".join(f"  R{k}: (R{k - 1} and x1 <= {k}) or (R{k - 1} and x1 >= {k})\n" for k in range(1, 60))
    text = DOCUMENT.replace("assume:", f"  R0: x1 >= 0\n{regions}assume:")
    with pytest.raises(ScenarioError, match=r"lot.yaml:\d+:\d+: the formula comes to more than 4096 parts"):
        Scenario.parse(text, "lot.yaml")


CONTINUOUS = DOCUMENT.replace("sampled", "continuous, speed: {x1: 2, x2: 1.5}")


def test_continuous_semantics_have_a_speed() -> None:
    scenario = Scenario.parse(CONTINUOUS)
    assert (scenario.semantics, scenario.speed) == ("continuous", {"x1": 2.0, "x2": 1.5})
    Scenario.parse(CONTINUOUS.replace("(P)", "(abs(x2 - 0.5*t) <= 1)"))


def test_a_region_that_is_not_used_needs_no_speed() -> None:
    text = CONTINUOUS.replace("(P)", "(O)").replace("x1: 2, ", "")
    assert Scenario.parse(text).speed == {"x2": 1.5}


@pytest.mark.parametrize("expression", ["x2 <= k", "norm(x1 - last(x1), x2) <= 1", "t - last(t) <= x2"])
def test_continuous_semantics_do_not_speak_about_samples(expression: str) -> None:
    text = CONTINUOUS.replace("always[0:1](P)", f"always[0:1]({expression})")
    with pytest.raises(ScenarioError, match=r"^scenario:4:35: '.*' speaks about samples \(k, last\)"):
        Scenario.parse(text)


def test_a_scenario_can_go_to_another_process() -> None:
    scenario = Scenario.load("roundabout")
    assert pickle.loads(pickle.dumps(scenario)).predicates == scenario.predicates


@pytest.mark.parametrize(("old", "new", "line", "column", "words"), DOCUMENTS)
def test_refusals_name_line_column_and_reason(old: str, new: str, line: int, column: int, words: str) -> None:
    assert old in DOCUMENT
    with pytest.raises(ScenarioError) as refused:
        Scenario.parse(DOCUMENT.replace(old, new, 1), "lot.yaml")
    first, *shown = str(refused.value).split("\n")
    assert first.startswith(f"lot.yaml:{line}:{column}: "), first
    assert words in first
    assert shown[-1].strip() == "^"


@pytest.mark.parametrize("text", ["", "3", "lot", "[]", "{}", "null", "x" * (MAX_BYTES + 1), "ä" * MAX_BYTES])
def test_what_is_no_map_is_refused(text: str) -> None:
    with pytest.raises(ScenarioError, match=r"^scenario:1:\d+: "):
        Scenario.parse(text)


def test_a_file_is_loaded_and_named_in_errors(tmp_path: Path) -> None:
    file = tmp_path / "lot.yaml"
    file.write_text(DOCUMENT, encoding="utf-8")
    assert Scenario.load(file).name == Scenario.load(str(file)).name == "lot"
    file.write_text(DOCUMENT.replace("[0:T]", "[0:S]"), encoding="utf-8")
    with pytest.raises(ScenarioError, match=f"^{file}:10:18: 'S' is not declared"):
        Scenario.load(file)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("nowhere", "no file and no shipped scenario 'nowhere': expected a file or one of .*parking-lot, .*roundabout"),
        ("parking-lot.yml", "did you mean parking-lot?"),
        ("../parking-lot", "did you mean parking-lot?"),
        ("", "is a directory"),
        ("a\0b", "null byte"),
    ],
)
def test_what_cannot_be_loaded_says_what_ships(name: str, words: str) -> None:
    with pytest.raises(ScenarioError, match=words.replace("?", r"\?")):
        Scenario.load(name)


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "lot.yaml"
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match="is not UTF-8 text"):
        Scenario.load(file)


def mutated() -> Iterator[st.SearchStrategy[str]]:
    """Documents near a sound one, and any text."""
    pieces = st.sampled_from([*DOCUMENT.split(" "), "\n", "[", "{", "'", '"', "&a", "*a", "!!int", "-", ": ", "1e999"])
    places = st.integers(0, len(DOCUMENT))
    yield st.tuples(places, pieces).map(lambda edit: DOCUMENT[: edit[0]] + edit[1] + DOCUMENT[edit[0] :])
    yield st.tuples(places, st.integers(1, 9)).map(lambda cut: DOCUMENT[: cut[0]] + DOCUMENT[cut[0] + cut[1] :])
    yield st.text()
    yield st.lists(pieces).map(" ".join)


@given(st.binary(max_size=300))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    with suppress(ScenarioError):
        Scenario.parse(data.decode("utf-8", "surrogateescape"))


@given(st.one_of(*mutated()))
def test_any_document_is_read_or_refused(text: str) -> None:
    with suppress(ScenarioError):
        Scenario.parse(text)


@pytest.mark.parametrize(
    ("text", "nanoseconds"),
    [
        ("1970-01-01T00:00:01Z", SECOND),
        ("2026-05-01T12:00:00Z", 1777636800 * SECOND),
        ("2026-05-01t12:00:00.5z", 1777636800 * SECOND + SECOND // 2),
        ("2026-05-01 14:30:00.123456789+02:30", 1777636800 * SECOND + 123456789),
        ("2026-05-01T11:59:59.999999999-00:00", 1777636800 * SECOND - 1),
    ],
)
def test_instants_are_exact(text: str, nanoseconds: int) -> None:
    assert instant_ns(text) == nanoseconds
    assert Scenario.parse(DOCUMENT.replace("on_start", f'"{text}"')).time_zero == nanoseconds


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("on_start", '"2200-01-01T00:00:01Z"', "expected 1970 to 2199"),
        ("on_start", '"1969-12-31T23:59:59Z"', "expected 1970 to 2199"),
        ("version: 1", f"version: {2**53}", "write a whole number from 1 to"),
    ],
)
def test_what_no_message_could_say_is_refused(before: str, after: str, words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        Scenario.parse(DOCUMENT.replace(before, after))


def profile(state: str, maps_to: str) -> VehicleProfile:
    text = f"{{class: car, state: {state}, sample_time: 0.05, maps_to: {maps_to}, future_inputs: limits}}"
    return parse_profile(yaml.safe_load(text))


def test_state_indices() -> None:
    scenario = Scenario.parse(DOCUMENT)
    assert scenario.state_indices(profile("{v: m/s, y: m, x: m}", "{x1: x, x2: y}")) == {"x1": 2, "x2": 1}
    assert scenario.state_indices(profile("{x2: m, x1: m}", "{}")) == {"x1": 1, "x2": 0}
    assert scenario.state_indices(profile("{x1: m, x2: m, x: m}", "{x1: x}")) == {"x1": 2, "x2": 1}


@pytest.mark.parametrize(
    ("state", "maps_to", "words"),
    [
        (
            "{x: m, y: m}",
            "{x1: x}",
            r"its state 'x2' is no state of class car \(x, y\): name its counterpart",
        ),
        ("{x1: m, x2: cm}", "{}", "its state 'x2' is in m, 'x2' of class car in cm"),
        ("{x1: m, a: {unit: m, angle: true}}", "{x2: a}", "its state 'x2' is an angle of class car, which 'P.x2' uses"),
    ],
)
def test_state_indices_that_there_are_not(state: str, maps_to: str, words: str) -> None:
    with pytest.raises(ScenarioError, match=f"^scenario lot: .*{words}"):
        Scenario.parse(DOCUMENT).state_indices(profile(state, maps_to))


ANGLE = "{x1: m, x2: {unit: m, angle: true}}"


@pytest.mark.parametrize(
    "comparison",
    [
        "cos(x2 - 0.5) >= 0.9",
        "x1*sin(2*x2 - last(x2) + t) + tan(-x2) >= 0",
        "cos(x2*0.5*4 - sin(x2))*cos(last(x2)) >= 0",
        "abs(sin(x2)) <= 0.5",
    ],
)
def test_angles_may_stand_in_periodic_functions(comparison: str) -> None:
    text = DOCUMENT.replace("(P)", f"({comparison})").replace("(O)", "(x1 >= 0)")
    assert Scenario.parse(text).state_indices(profile(ANGLE, "{}")) == {"x1": 0, "x2": 1}


@pytest.mark.parametrize(
    "comparison",
    [
        "x2 >= 0",
        "x1 + x2 >= 0",
        "norm(x1, x2) <= 1",
        "cos(x2/2) >= 0.9",
        "sin(x2^2) >= 0",
        "exp(x2) >= 3",
        "cos(x2) >= last(x2)",
        "sin(last(x2)*x2) >= 0",
        "cos(x2) + min(x2, x1) >= 0",
        "atan2(x2, x1) >= 0",
    ],
)
def test_angles_may_stand_nowhere_else(comparison: str) -> None:
    text = DOCUMENT.replace("always[0:1](P)", f"always[0:1]({comparison})").replace("(P)", "(x1 >= 0)")
    scenario = Scenario.parse(text.replace("(O)", "(x1 >= 0)"))
    with pytest.raises(ScenarioError, match="'x2' is an angle of class car"):
        scenario.state_indices(profile(ANGLE, "{}"))
