"""Scenario documents: what ships, what is refused and where, when which predicate is active."""

import pickle
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus.messages import VehicleProfile, parse_profile
from side_info import DiscPredicate, Formula, LinearPredicate, Scenario, ScenarioError, shipped
from side_info.document import instant_ns
from side_info.yaml_text import MAX_BYTES
from tests.side_info.corpus import DOCUMENT, DOCUMENTS

SECOND = 10**9


def test_the_parking_lot_has_the_numbers_of_the_paper() -> None:
    scenario = Scenario.load("parking-lot")
    assert [(timed.predicate, timed.start_ns, timed.end_ns) for timed in scenario.predicates] == [
        (LinearPredicate("P.x1", {"x1": 1.0}, -1.437, 1.998), 0, 25 * SECOND),
        (LinearPredicate("P.x2", {"x2": 1.0}, -1.59, 3.268), 0, 25 * SECOND),
        (LinearPredicate("O", {"x2": 1.0}, -2.665, -0.665), 25 * SECOND, 40 * SECOND),
    ]
    # h1 to h5 as printed: half-width - |state + shift|
    for region, state, half, shift in (
        ("P", "x1", 1.7175, -0.2805),
        ("P", "x2", 2.429, -0.839),
        ("gate", "x1", 1.3045, 0.3225),
        ("gate", "x2", 0.453, 1.137),
        ("O", "x2", 1.0, 1.665),
    ):
        (strip,) = [p for p in scenario.regions[region] if p.states == (state,)]
        assert isinstance(strip, LinearPredicate)
        assert (strip.lower, strip.upper) == pytest.approx((-shift - half, -shift + half), abs=1e-12)
    assert scenario.end_ns == 40 * SECOND
    assert scenario.time_zero is None


def test_the_roundabout_has_the_numbers_of_the_paper() -> None:
    scenario = Scenario.load("roundabout")
    assert [(timed.predicate, timed.start_ns, timed.end_ns) for timed in scenario.predicates] == [
        (LinearPredicate("B", {"x2": 1.0}, 1.25, 3.25), 0, 4 * SECOND),
        (DiscPredicate("ring", {"x1": 0.307, "x2": 0.044}, 1.429), 4 * SECOND, 10 * SECOND),
        (LinearPredicate("A", {"x2": 1.0}, -3.169, -1.169), 10 * SECOND, 14 * SECOND),
    ]


@pytest.mark.parametrize("name", shipped())
def test_what_ships_is_named_as_its_file_and_reads_back(name: str) -> None:
    scenario = Scenario.load(name)
    assert scenario.name == name
    again = Scenario.parse(scenario.text)
    assert (again.predicates, again.assume) == (scenario.predicates, scenario.assume)


def test_shipped_scenarios() -> None:
    assert {"parking-lot", "roundabout"} <= set(shipped())


def test_a_document_in_full() -> None:
    scenario = Scenario.parse(DOCUMENT, "lot.yaml")
    assert (scenario.name, scenario.version, scenario.text) == ("lot", 1, DOCUMENT)
    assert scenario.state == {"x1": "m", "x2": "m"}
    assert str(scenario.assume) == "always[0:25](P) and always[25:40](O)"
    assert {name: str(formula) for name, formula in scenario.monitor.items()} == {"stays": "always[0:1](P)"}
    assert scenario.regions["D"] == (DiscPredicate("D", {"x1": 0.0, "x2": 0.5}, 2.0),)
    assert scenario.regions["O"] == (LinearPredicate("O", {"x2": 1.0}, -3.0, 0.0),)
    assert isinstance(scenario.assume, Formula)


def test_a_region_may_name_those_above_it() -> None:
    text = DOCUMENT.replace("assume:", "  Q: P and 0 <= x1 <= x2\nassume:")
    assert [(p.name, p.states) for p in Scenario.parse(text).regions["Q"]] == [
        ("Q.1", ("x1",)), ("Q.2", ("x2",)), ("Q.3", ("x1",)), ("Q.4", ("x1", "x2")),
    ]  # fmt: skip


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


@pytest.mark.parametrize("name", ["nowhere", "parking-lot.yml", "", "a\0b", "../parking-lot"])
def test_what_cannot_be_loaded_says_what_ships(name: str) -> None:
    with pytest.raises(ScenarioError, match=r"cannot be read: .*expected a file or one of parking-lot, roundabout"):
        Scenario.load(name)


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "lot.yaml"
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match="cannot be read"):
        Scenario.load(file)


def mutated() -> Iterator[st.SearchStrategy[str]]:
    """Documents near a sound one, and any text."""
    pieces = st.sampled_from([*DOCUMENT.split(" "), "\n", "[", "{", "'", '"', "&a", "*a", "!!int", "-", ": ", "1e999"])
    places = st.integers(0, len(DOCUMENT))
    yield st.tuples(places, pieces).map(lambda edit: DOCUMENT[: edit[0]] + edit[1] + DOCUMENT[edit[0] :])
    yield st.tuples(places, st.integers(1, 9)).map(lambda cut: DOCUMENT[: cut[0]] + DOCUMENT[cut[0] + cut[1] :])
    yield st.text()
    yield st.lists(pieces).map(" ".join)


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


def test_activity_at_the_boundaries_of_windows() -> None:
    scenario = Scenario.parse(DOCUMENT)
    for tau, active in (
        (-1, [False, False, False]),
        (0, [True, True, False]),
        (25 * SECOND - 1, [True, True, False]),
        (25 * SECOND, [True, True, True]),
        (25 * SECOND + 1, [False, False, True]),
        (40 * SECOND, [False, False, True]),
        (40 * SECOND + 1, [False, False, False]),
        (2**63 - 1, [False, False, False]),
        (-(2**63), [False, False, False]),
    ):
        assert scenario.active(tau).tolist() == active, tau


def test_slack_shortens_windows_from_both_ends() -> None:
    scenario = Scenario.parse(DOCUMENT)
    slack = 3_000_001
    taus = np.array([slack - 1, slack, 25 * SECOND - slack, 25 * SECOND - slack + 1, 25 * SECOND, 25 * SECOND + slack])
    assert scenario.active(taus, slack)[:, [0, 2]].tolist() == [
        [False, False],
        [True, False],
        [True, False],
        [False, False],
        [False, False],
        [False, True],
    ]


@given(
    st.lists(st.integers(-(2**40), 2**40), min_size=1, max_size=5),
    st.lists(st.integers(0, 2**36), min_size=1, max_size=4),
)
def test_activity_broadcasts_and_agrees_with_its_definition(taus: list[int], slacks: list[int]) -> None:
    scenario = Scenario.parse(DOCUMENT)
    active = scenario.active(np.array(taus)[:, None], np.array(slacks))
    assert active.shape == (len(taus), len(slacks), 3)
    for i, tau in enumerate(taus):
        for j, slack in enumerate(slacks):
            expected = [t.start_ns + slack <= tau <= t.end_ns - slack for t in scenario.predicates]
            assert active[i, j].tolist() == expected


@pytest.mark.parametrize(("tau", "slack"), [(0, -1), (0, 2**62 + 1), (0.5, 0), (0, 0.5)])
def test_activity_is_about_whole_nanoseconds(tau: float, slack: float) -> None:
    with pytest.raises(ValueError, match=r"integers of nanoseconds|between 0 and"):
        Scenario.parse(DOCUMENT).active(np.array(tau), np.array(slack))


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
        ("{x1: m, a: {unit: m, angle: true}}", "{x2: a}", "'a' of class car is an angle"),
    ],
)
def test_state_indices_that_there_are_not(state: str, maps_to: str, words: str) -> None:
    with pytest.raises(ScenarioError, match=f"^scenario lot: .*{words}"):
        Scenario.parse(DOCUMENT).state_indices(profile(state, maps_to))
