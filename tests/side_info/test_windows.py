"""A formula to predicates on windows, and how they are named."""

import pytest

from side_info import Declarations, Formula, LinearPredicate, ScenarioError, TimedPredicate
from side_info.places import Excerpt
from side_info.windows import MAX_PREDICATES, timed_predicates, timeless_predicates

STRIP = LinearPredicate("O", {"x2": 1.0}, -1.0, 1.0)
REGIONS = {
    "P": (LinearPredicate("P.x1", {"x1": 1.0}, 0.0, 1.0), LinearPredicate("P.x2", {"x2": 1.0}, 0.0, 1.0)),
    "O": (STRIP,),
}


def timed(text: str) -> tuple[TimedPredicate, ...]:
    formula = Formula.parse(text, Declarations(("x1", "x2"), tuple(REGIONS)))
    return timed_predicates(formula, REGIONS, Excerpt.alone(text, "test"))


def names(text: str) -> list[str]:
    return [predicate.name for predicate in timed(text)]


def test_each_predicate_of_a_region_gets_the_window() -> None:
    assert [(p.name, p.start_ns, p.end_ns) for p in timed("always[0:2](P) and always[2:2.5](O)")] == [
        ("P.x1", 0, 2 * 10**9),
        ("P.x2", 0, 2 * 10**9),
        ("O", 2 * 10**9, 25 * 10**8),
    ]


def test_a_predicate_carries_its_unique_name() -> None:
    assert all(timed_.predicate.name == timed_.name for timed_ in timed("G[0:1](P and O) and G[3:4](O)"))


def test_a_name_on_several_windows_tells_them_apart() -> None:
    assert names("G[0:1](P) and G[3:4.5](O) and G[6:7](O and x1 <= 2)") == [
        "P.x1", "P.x2", "O[3:4.5]", "O[6:7]", "x1 <= 2",
    ]  # fmt: skip


def test_what_is_said_twice_is_one() -> None:
    assert names("G[0:1](P and P) and G[0:1](O) and (G[0:1](O) and G[0:1](P))") == ["P.x1", "P.x2", "O"]


def test_equal_names_of_different_predicates_are_numbered() -> None:
    long = " + ".join(["x1"] * 30)
    found = names(f"G[0:1]({long} <= 2 and {long} <= 3)")
    assert [name[-2:] for name in found] == ["#1", "#2"]
    assert all(len(name) == 82 for name in found)


def test_a_timeless_formula_has_no_always() -> None:
    formula = Formula.parse("P and O", Declarations((), ("P", "O")))
    assert timeless_predicates(formula, REGIONS, Excerpt.alone("P and O", "test")) == (*REGIONS["P"], STRIP)


def test_an_explosion_of_regions_is_refused() -> None:
    regions = {"R": tuple(LinearPredicate(f"R.{k}", {"x1": 1.0}, 0.0, float(k)) for k in range(100))}
    text = "G[0:1](R and R and R)"
    formula = Formula.parse(text, Declarations((), ("R",)))
    with pytest.raises(ScenarioError, match=f"more than {MAX_PREDICATES} predicates"):
        timed_predicates(formula, regions, Excerpt.alone(text, "test"))
