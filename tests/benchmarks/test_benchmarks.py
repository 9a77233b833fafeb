"""The benchmarks compare what they say they compare."""

import json

import numpy as np
import pytest

from benchmarks.__main__ import NAMES, main
from benchmarks.families import CUT_FAMILIES, Sets, cuts, random_rows, strip_cuts
from benchmarks.peers import Program, linprog_support, zonoopt_set, zonoopt_settings
from benchmarks.report import Claim, Table, as_json, as_markdown
from benchmarks.strips import exact_area
from reach_server.sets.planar import clip, polygon_area


@pytest.mark.parametrize("sets", [random_rows(4, 12, 3), strip_cuts(4, 12, 3)], ids=lambda sets: sets.name)
def test_all_sides_are_asked_the_same(sets: Sets) -> None:
    direction = np.array([0.6, -0.8])
    for i in range(len(sets)):
        wanted = linprog_support(sets, i, direction)
        assert Program(sets, i).support(direction) == pytest.approx(wanted, rel=1e-7)
        theirs = zonoopt_set(sets, i).support(direction, settings=zonoopt_settings(1e-9))
        assert theirs == pytest.approx(wanted, rel=1e-5)
        assert sets.one(i).support(direction[None])[0] == pytest.approx(wanted, rel=1e-2)


@pytest.mark.parametrize("name", CUT_FAMILIES)
def test_the_exact_area_is_that_of_the_clipped_polygon(name: str) -> None:
    family = cuts(name, 5)
    for i, polygon in enumerate(family.zonotopes.polygon()):
        kept = clip(polygon, family.normal[i], family.middle[i] + family.radius[i])
        kept = clip(kept, -family.normal[i], family.radius[i] - family.middle[i])
        assert exact_area(family)[i] == pytest.approx(float(polygon_area(kept)), rel=1e-9)


def test_a_report_says_what_was_missed() -> None:
    claims = [
        Claim("enough", 21.0, "≥", 20.0),
        Claim("too much", 1.6, "≤", 1.5),
        Claim("unknown", float("nan"), "≤", 1.0),
    ]
    tables = {"a": Table("A", "Note.", ("way", "µs"), [("ours", 1.25), ("theirs", 12345.6)], claims)}
    where = {"date": "2026-11-22", "machine": "m", "python": "3.11", "versions": {"numpy": "2.4"}}
    page = as_markdown(where, tables)
    assert "| enough | 21 | ≥ 20 | met |" in page
    assert "| too much | 1.6 | ≤ 1.5 | MISSED |" in page
    assert "| unknown | nan | ≤ 1 | MISSED |" in page
    assert "| way | µs |\n| --- | ---: |\n| ours | 1.25 |\n| theirs | 12346 |" in page
    document = json.loads(json.dumps(as_json(where, tables)))
    assert document["benchmarks"]["a"]["rows"] == [{"way": "ours", "µs": 1.25}, {"way": "theirs", "µs": 12345.6}]
    assert [claim["met"] for claim in document["benchmarks"]["a"]["claims"]] == [True, False, False]


def test_an_unknown_name_is_wrong_use(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["strips", "nonsense"])
    assert f"no benchmark nonsense; there are {', '.join(NAMES)}" in capsys.readouterr().err
