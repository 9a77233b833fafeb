"""CONTRIBUTING.md keeps step with the tree, and what it says has to be touched is enough."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Annotated, ClassVar, get_args

import casadi
import msgpack
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from fleet_bus.errors import MessageError, ScenarioError
from fleet_bus.messages import Assignment, ranges
from fleet_bus.messages.fields import Field, FieldList
from fleet_bus.messages.kinds import Array, Text, Whole
from fleet_bus.messages.methods import CutMethod
from fleet_cli.scenario_plane import lay_out
from reach_server.predicates import Literals
from reach_server.predicates.apply import cut_sets
from reach_server.predicates.cut_kinds import CUT_KINDS, CutKind
from reach_server.sets import Zonotope
from reach_server.sets.raw import RawSets
from side_info import NonlinearPredicate, Scenario
from side_info.stl.angles import misused_angle
from side_info.stl.functions import FUNCTIONS, Function, NoNumberError, of_doubles
from tests.reach_server.predicates.asking import context, kept, members

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "CONTRIBUTING.md"
ARCHITECTURE = ROOT / "docs" / "concepts" / "architecture.md"
#: What a path may begin with or be, as git tracks it; what a step of the recipes makes is none.
TOP = {path.name for path in ROOT.iterdir()}
#: Recipes that touch at most three files of the product.
SHORT = ("a method", "a way to cut", "a predicate function", "a message field", "a metric")


def paths(text: str) -> set[str]:
    """What is written as code and has the form of a path in this tree."""
    code = re.findall(r"`([^`\n]+)`", re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S))
    return {
        word for word in code if re.fullmatch(r"[\w./-]+", word) and ("/" in word or word in TOP) and "…" not in word
    }


def recipes() -> dict[str, str]:
    """Title of each recipe to its text."""
    found = re.findall(r"^### (.+?)\n(.*?)(?=^#|\Z)", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    return dict(found)


def touched(recipe: str) -> list[str]:
    """Files of the product in the steps of a recipe that always have to be done."""
    steps = re.findall(r"^\d+\. (.*?)(?=^\d+\. |^\n|\Z)", recipe, re.M | re.S)
    return [step for step in steps if not re.match(r"`(docs|tests)/", step)]


@pytest.mark.parametrize("page", [PAGE, ARCHITECTURE], ids=lambda path: str(path.name))
def test_every_file_that_is_named_exists(page: Path) -> None:
    named = paths(page.read_text(encoding="utf-8"))
    assert len(named) > 15
    assert {name for name in named if not (ROOT / name).exists()} == set()


def test_the_packages_of_the_table_are_those_of_the_tree_in_the_order_of_their_imports() -> None:
    (table,) = re.findall(r"^\| package \|.*?\n\n", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    listed = re.findall(r"^\| `([\w/]+)` \|", table, re.M)
    there = {path.parent for path in ROOT.glob("*/__init__.py")} | {
        p.parent for p in ROOT.glob("reach_server/*/__init__.py")
    }
    assert set(listed) == {path.relative_to(ROOT).as_posix() for path in there}
    contracts = re.findall(r"^layers = \[(.*?)\]", (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.M | re.S)
    top, inside = ([re.findall(r"\w+", layer) for layer in re.findall(r'"([^"]+)"', text)] for text in contracts)
    for order, prefix in ((top, ""), (inside, "reach_server/")):
        places = [[listed.index(prefix + name) for name in layer] for layer in order]
        assert all(max(lower) < min(upper) for upper, lower in pairwise(places)), places


def test_each_recipe_is_there_and_the_short_ones_touch_three_files_at_most() -> None:
    found = recipes()
    assert list(found) == ["a set operation", "a source", *SHORT]
    for name in SHORT:
        assert 1 <= len(touched(found[name])) <= 3, name


def test_the_questions_of_the_architecture_are_answered_by_a_file() -> None:
    (table,) = re.findall(r"^\| to change ….*?(?=^\n|\Z)", ARCHITECTURE.read_text(encoding="utf-8"), re.M | re.S)
    rows = re.findall(r"^\| ([^|]+) \| ([^|]+) \|", table, re.M)[2:]
    assert len(rows) >= 8
    for question, answer in rows:
        assert paths(answer), question


# --- a predicate function ---------------------------------------------------------------------------------------------


def _versine(values: Sequence[Fraction]) -> Fraction:
    if abs(values[0]) > 10**6:
        raise NoNumberError("versin of so large an angle has no digits left")
    return 1 - of_doubles(np.cos)(values)


@pytest.fixture
def versine(monkeypatch: pytest.MonkeyPatch) -> None:
    """1 - cos x, entered as the recipe says."""
    entry = Function(_versine, lambda x: 1 - np.cos(x), lambda c, x: 1 - c.cos(x), periodic=True)
    monkeypatch.setitem(FUNCTIONS, "versin", entry)


DOCUMENT = """\
scenario: dummy
version: 1
state: {{x: m, y: m, yaw: rad}}
time: {{zero: on_start, semantics: sampled}}
regions: {{R: "{region}"}}
assume: always[0:1 s](R)
"""


def predicate(region: str) -> NonlinearPredicate:
    (found,) = Scenario.parse(DOCUMENT.format(region=region)).predicates
    assert isinstance(found, NonlinearPredicate)
    return found


@pytest.mark.usefixtures("versine")
def test_a_function_of_the_table_is_parsed_computed_and_drawn() -> None:
    folded = Scenario.parse(DOCUMENT.format(region="x <= versin(0)"))
    assert [p.upper for p in folded.predicates] == [0.0]  # type: ignore[union-attr]
    with pytest.raises(ScenarioError, match=r"5:\d+: versin of so large an angle"):
        Scenario.parse(DOCUMENT.format(region="x <= versin(1e7)"))
    with pytest.raises(ScenarioError, match="versin takes one argument, 2 came"):
        Scenario.parse(DOCUMENT.format(region="versin(x, y) >= 0"))
    assert misused_angle(predicate("versin(2 * yaw) >= x"), {"yaw"}) is None
    assert misused_angle(predicate("versin(yaw / 2) >= x"), {"yaw"}) == "yaw"
    plane, drawn, left_out = lay_out(Scenario.parse(DOCUMENT.format(region="y <= versin(x)")))
    assert plane is not None
    assert not left_out
    x, y = np.meshgrid(plane.x, plane.y)
    np.testing.assert_allclose(drawn[0].margin, 1 - np.cos(x) - y, atol=1e-12)


@pytest.mark.usefixtures("versine")
def test_a_function_of_the_table_cuts_and_keeps_every_state_that_may_satisfy_it() -> None:
    literals = Literals(2, (0, 1), np.zeros((2, 0)))
    index = {"x": 0, "y": 1}
    literal = literals.add(
        predicate("0.5 - versin(x) - y^2 >= 0"), index, scenario="s", name="p", speed=0.0, margin_ns=0
    )
    rng = np.random.default_rng(1)
    center, generators = rng.normal(size=(200, 2)), rng.normal(size=(200, 2, 3)) / 2
    given = context(200, 2)
    strips, empty = literals.strips(literal, center, generators, given)
    points = members(rng, center, generators, 200)
    holds = 0.5 - (1 - np.cos(points[..., 0])) - points[..., 1] ** 2 >= 0
    assert holds.any()
    assert not (holds & ~kept(strips, points)).any()
    assert not (holds.any(axis=1) & empty).any()
    assert (~kept(strips, points)).any()
    assert empty.any()


def test_the_columns_of_the_table_agree() -> None:
    rng = np.random.default_rng(0)
    for name, function in FUNCTIONS.items():
        for count in {function.least, function.most or 3}:
            for _ in range(20):
                numbers = [Fraction(int(n), 8) for n in rng.integers(1, 40, count)]
                doubles = [float(number) for number in numbers]
                exact = float(function.exact(numbers))
                graph = float(casadi.evalf(function.graph(casadi, *map(casadi.SX, doubles))))
                array = function.array(*(np.array([value]) for value in doubles))
                np.testing.assert_allclose([graph, array[0]], exact, rtol=1e-13, atol=1e-13, err_msg=name)
                if function.needs is not None:
                    demand, operand = function.needs
                    value = float(casadi.evalf(operand(casadi, *map(casadi.SX, doubles))))
                    assert value != 0 if demand == "nonzero" else value > 0


# --- a message field --------------------------------------------------------------------------------------------------

LANE = ranges.Range(0, 9)


class WithLane(Assignment):
    """An assignment with one more field, entered as the recipe says."""

    lane: Annotated[int, LANE] = 0


def test_a_field_of_a_document_is_checked_described_and_has_its_default() -> None:
    before = Assignment(scenario="s", vehicle="v", time_zero=10**18)
    assert WithLane.decode(before.encode()).lane == 0
    sent = WithLane(scenario="s", vehicle="v", time_zero=10**18, lane=3)
    assert WithLane.decode(sent.encode()) == sent
    assert (
        WithLane.json_schema()["properties"]["lane"].items() >= {"type": "integer", "default": 0, **LANE.json()}.items()
    )
    for wrong, reason in ((10, "range"), ("3", "fields"), (3.0, "fields")):
        with pytest.raises(MessageError) as refused:
            WithLane.decode(msgpack.packb({**msgpack.unpackb(sent.encode()), "lane": wrong}))
        assert refused.value.reason == reason
        assert "lane" in str(refused.value)
    # Why the recipe asks for a new version where readers are not replaced together with their writers.
    with pytest.raises(MessageError, match="lane"):
        Assignment.decode(sent.encode())


@dataclass(frozen=True)
class Load:
    """A binary message of one state and, since lately, the weight of what it carries on each axle."""

    vehicle: str
    axles: NDArray[np.float64]
    lane: int = 0

    FIELDS: ClassVar = FieldList(
        Field("v", "vehicle", Text(), "", "id of the vehicle"),
        Field("w", "axles", Array("<f4", ("k", "2"), ranges.SIZE, ranges.STATES), "kg", "weight left and right"),
    )


def test_a_field_of_a_binary_message_follows_from_its_row() -> None:
    fields = FieldList(*Load.FIELDS.fields, Field("q", "lane", Whole(LANE), "", "which lane it keeps"))
    sent = Load("v", np.arange(6.0).reshape(3, 2), lane=3)
    packed = fields.pack(sent)
    assert packed.keys() == {"v", "w", "q"}
    found = Load(**fields.read(packed))
    assert (found.vehicle, found.lane) == ("v", 3)
    np.testing.assert_array_equal(found.axles, sent.axles)
    assert fields.fields[-1].json().items() >= {"title": "lane", "type": "integer", **LANE.json()}.items()
    for wrong, reason in (
        ({"q": 10}, "range"),
        ({"q": 1.0}, "fields"),
        ({"w": b"0" * 9}, "shape"),
        ({"w": b""}, "shape"),
    ):
        with pytest.raises(MessageError) as refused:
            fields.check(Load(**fields.read({**packed, **wrong})))
        assert refused.value.reason == reason
        assert next(iter(wrong)) in str(refused.value)
    with pytest.raises(MessageError, match="missing \\['q'\\]"):
        fields.read(Load.FIELDS.pack(sent))


# --- a way to cut -----------------------------------------------------------------------------------------------------


def test_every_way_to_cut_that_has_a_name_is_in_the_table() -> None:
    assert set(CUT_KINDS) == set(get_args(CutMethod))


@pytest.mark.parametrize("entry", [CutKind(passes=3), CutKind(keeps_larger_result=True, passes=2)])
def test_a_way_to_cut_of_the_table_is_followed(monkeypatch: pytest.MonkeyPatch, entry: CutKind) -> None:
    monkeypatch.setitem(CUT_KINDS, "dummy", entry)  # type: ignore[misc]
    literals = Literals(2, (0, 1), np.zeros((2, 0)))
    regions = Scenario.parse(DOCUMENT.format(region="x + y <= 0.5 and x^2 + y <= 1"))
    for predicate in regions.predicates:
        literals.add(predicate, {"x": 0, "y": 1}, scenario="s", name="p", speed=0.0, margin_ns=0)
    rng = np.random.default_rng(2)
    start = RawSets.zonotope(rng.normal(size=(100, 2)) / 2, rng.normal(size=(100, 2, 4)) / 3)
    asked = np.ones((100, literals.count), dtype=bool)
    cut = cut_sets(start, asked, literals, lambda literal, rows: context(len(rows), 2), "dummy", 2, (0, 1))  # type: ignore[arg-type]
    points = members(rng, start.center, start.generators, 100)
    holds = (points.sum(axis=2) <= 0.5) & (points[..., 0] ** 2 + points[..., 1] <= 1)
    left = Zonotope(cut.sets.center, cut.sets.generators)
    inside = np.stack([np.asarray(left.contains_point(points[:, k])) for k in range(points.shape[1])], axis=1)
    there = holds & ~cut.empty.any(axis=1, keepdims=True)
    assert there.any()
    assert inside[there].all()
    assert not (holds.any(axis=1) & cut.empty.any(axis=1)).any()
    assert not inside.all()


# --- habits -----------------------------------------------------------------------------------------------------------


def test_the_version_that_is_cited_is_that_of_the_project() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = re.search(r'^version = "(.+)"', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.M)
    assert project is not None
    assert cited["version"] == project[1]
    assert cited["license"] == "Apache-2.0"
