"""Predicates of documents that are in force no more are forgotten, and what is asked stays what it was."""

import numpy as np
import pytest

from reach_server.side_information.scenarios import MOST_UNUSED
from tests.reach_server.scenarios import scenario
from tests.reach_server.side_information.watched import OUTSIDE, START, STEP, Watched, box


def test_what_replaced_documents_asked_for_is_forgotten() -> None:
    watched = Watched(3)
    keeps = scenario("always[0:60 s](x2 <= 50) and eventually[0:60 s](x1 >= 100)", name="keeps")
    watched.made.assign(2, keeps, START, 0.0)
    for version in range(110):
        document = scenario(f"always[0:60 s](x1 <= {version + 1}.5)", name="versions")
        watched.made.assign(0, document, START, 0.0)
        watched.made.assign(1, document, START + STEP, 0.0)
        seconds = version / 10
        for slot in (0, 1, 2):
            assert not watched.see(slot, seconds, [0.0, 0.25, 0.0])
        assert watched.asked(0) == [{f"x1 <= {version + 1}.5"}]
        assert watched.asked(2) == [{"x2 <= 50"}]
        assert watched.made.literals.count <= MOST_UNUSED + 4
    assert watched.made.literals.held <= MOST_UNUSED + 4
    events = [event for slot in (0, 1, 2) for event in watched.see(slot, 11.0, [0.0, 400.0, 99.0])]
    assert [(e.vehicle, e.details["predicate"]) for e in events] == [
        ("car-0", "x1 <= 110.5"), ("car-1", "x1 <= 110.5"), ("car-2", "x2 <= 50"),
    ]  # fmt: skip


def test_scenarios_that_nobody_takes_part_in_any_more_leave_nothing() -> None:
    watched = Watched(2)
    watched.made.assign(1, box("stays", "0:90 s"), START, 0.0)
    for number in range(200):
        name = f"s{number}"
        watched.made.assign(0, scenario(f"always[0:5 s](x2 <= {number}.0)", name=name), START, 0.0)
        watched.made.unassign(0, name)
    assert watched.made.literals.held <= MOST_UNUSED + 2
    assert watched.see(1, 0.1, OUTSIDE)


def test_a_released_literal_has_no_meaning_until_another_takes_its_number() -> None:
    literals = Watched().made.literals
    predicates = [scenario(f"always[0:1 s](x1 <= {bound})").predicates[0] for bound in (1, 2, 3)]
    index = {"x1": 1}
    first, second, third = (literals.add(p, index, scenario="s", name=p.name) for p in predicates)
    literals.release({second})
    assert (literals.count, literals.held) == (3, 1)
    assert [literals.name(number) for number in (first, second, third)] == ["", "x1 <= 2", ""]
    with pytest.raises(KeyError, match="released"):
        literals.fixed_strips(first)
    assert literals.add(predicates[2], index, scenario="s", name="again") == first
    assert literals.name(first) == "again"
    np.testing.assert_array_equal(literals.fixed_strips(first).upper, [3.0])
    assert literals.add(predicates[1], index, scenario="s", name=predicates[1].name) == second
