"""The benchmarks compare what they say they compare."""

import numpy as np
import pytest

from benchmarks.families import CUT_FAMILIES, Sets, cuts, random_rows, strip_cuts
from benchmarks.peers import Program, linprog_support, zonoopt_set, zonoopt_settings
from benchmarks.strips import exact_area
from reach_server.sets.polygon import clip, polygon_area


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
