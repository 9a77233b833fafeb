"""When a formula asks for which predicate."""

import numpy as np
import pytest

from fleet_cli.scenario_activity import MOST_STEPS, activity, spans
from side_info import Scenario
from side_info.progression import Grid, Table, frontier

DOCUMENT = """\
scenario: boxes
version: 1
state: {{x1: m, x2: m}}
time: {{zero: on_start, semantics: sampled}}
regions: {{P: x1 >= 0, Q: x2 >= 0}}
assume: {formula}
"""


def asked(formula: str) -> dict[str, tuple[str, str]]:
    """For each predicate and sample of half a second whether it is asked for: in any case, and in some."""
    scenario = Scenario.parse(DOCUMENT.format(formula=formula))
    found = activity(scenario, 0.5)
    return {
        predicate.name: ("".join(map(str, every.astype(int))), "".join(map(str, some.astype(int))))
        for predicate, every, some in zip(scenario.predicates, found.always.T, found.some.T, strict=True)
        if some.any()
    }


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("P", {"P": ("1", "1")}),
        ("always[0.4:1.2](P)", {"P": ("011", "011")}),
        ("always[0.6:0.9](P) and always[0:1](Q)", {"Q": ("111", "111")}),
        ("eventually[0:1](P)", {"P": ("000", "111")}),
        ("eventually[1:1](P)", {"P": ("001", "001")}),
        ("always[0:0.5](eventually[0:1](P))", {"P": ("0000", "1111")}),
        ("eventually[0:0.5](always[0:1](P))", {"P": ("0110", "1111")}),
        ("always[0:0.5](P) or always[0:1](P and Q)", {"P": ("110", "111"), "Q": ("000", "111")}),
        ("P until[0.5:1] Q", {"P": ("110", "111"), "Q": ("000", "011")}),
        ("always[0:1](P -> eventually[0:0.5](Q))", {"not P": ("0000", "1110"), "Q": ("0000", "1111")}),
    ],
)
def test_formulas(formula: str, expected: dict[str, tuple[str, str]]) -> None:
    assert asked(formula) == expected


@pytest.mark.parametrize(
    ("name", "sample_time"),
    [
        ("parking-lot", 0.25),
        ("parking-lot-motion", 0.25),
        ("parking-lot-paper", 0.25),
        ("roundabout", 0.25),
        ("convoy", 1.0),
        ("intersection", 1.0),
    ],
)
def test_progression_asks_for_no_less_in_any_case_and_for_no_more_in_some(name: str, sample_time: float) -> None:
    """It may drop a way that another makes needless, where the formula spells out both."""
    scenario = Scenario.load(name)
    found = activity(scenario, sample_time)
    table = Table(max_alternatives=1024)
    root = table.add(scenario.side_information, Grid(round(sample_time * 1e9)), lambda predicate, _: predicate)
    equal = 0
    for k, (every, some) in enumerate(frontier(table, root, len(found.some))):
        here = frozenset(np.flatnonzero(found.always[k]).tolist()), frozenset(np.flatnonzero(found.some[k]).tolist())
        assert here[0] <= every
        assert some <= here[1]
        equal += here == (every, some)
    assert equal >= 0.95 * len(found.some)


def test_what_goes_on_for_ever_is_cut_short() -> None:
    scenario = Scenario.parse(DOCUMENT.format(formula="always[0:9e8](eventually[0:10](P)) and always[5e8:6e8](Q)"))
    found = activity(scenario, 0.05)
    assert found.cut_short
    assert len(found.some) == MOST_STEPS
    assert found.some[:, 0].all()
    assert not found.some[:, 1].any()


def test_spans() -> None:
    active = np.array([1, 1, 0, 0, 1, 0, 1, 1, 1], dtype=bool)
    assert spans(active, 0.5) == [(0.0, 0.5), (2.0, 2.0), (3.0, 4.0)]
    assert spans(~active[:2], 0.5) == []
