"""What the paper's tables come to: the bounds of the design, containment, and that a seed says everything."""

from dataclasses import replace

import numpy as np
import pytest

from fleet_bus.errors import UsageError
from fleet_lab.paper import cells, cuts, models
from fleet_lab.paper.cells import KINDS, NONE, NONE_RING, PRINTED, Block, Cell
from fleet_lab.paper.drives import Data, history, simulate
from fleet_lab.paper.formulas import FORMULAS, PHI_P, PHI_R, PHI_THETA
from fleet_lab.paper.study import PUBLISHED, Study, drive_of, measured

BOUNDS = {
    (NONE, "zonotope"): (9.72, 9.73),
    (NONE_RING, "zonotope"): (9.72, 9.73),
    ("phi_p", "zonotope"): (10.344, 10.364),
    ("phi_p", "constrained"): (6.5, 7.1),
    ("phi_theta", "zonotope"): (0.121, 0.127),
    ("phi_theta", "constrained"): (0.074, 0.078),
    ("phi_r", "zonotope"): (8.8, 8.95),
    ("phi_r", "constrained"): (5.7, 5.95),
}
CLAIMS = {
    (NONE, "zonotope"): 0.01,
    (NONE_RING, "zonotope"): 0.01,
    ("phi_theta", "zonotope"): 0.01,
    ("phi_theta", "constrained"): 0.01,
    ("phi_p", "constrained"): 0.05,
    ("phi_r", "constrained"): 0.05,
    ("phi_r", "zonotope"): 0.03,
}
UNCUT = {NONE, NONE_RING}
SIMULATED = ("published_code", "printed_text", "ours", "ours_with_noise", "routes")


def cells_of(block: Block) -> dict[tuple[str, str], Cell]:
    return {(cell.formula, cell.kind): cell for cell in block.cells}


@pytest.fixture(scope="module")
def other_study() -> Study:
    return Study(2)


@pytest.fixture(scope="module")
def other(other_study: Study) -> Block:
    return other_study.published_code(lambda part: None)


def test_the_printed_tables_are_those_of_the_paper(blocks: dict[str, Block]) -> None:
    assert PRINTED == {
        ("none", "zonotope"): 9.722, ("none_ring", "zonotope"): 9.722,
        ("phi_p", "zonotope"): 9.311, ("phi_p", "constrained"): 7.042,
        ("phi_theta", "zonotope"): 0.124, ("phi_theta", "constrained"): 0.076,
        ("phi_r", "zonotope"): 9.109, ("phi_r", "constrained"): 5.956,
    }  # fmt: skip
    assert {key: cell.area for key, cell in cells_of(blocks["printed"]).items()} == PRINTED


@pytest.mark.parametrize(("formula", "kind"), BOUNDS)
def test_the_published_code_makes_the_areas_of_the_design(
    blocks: dict[str, Block], other: Block, formula: str, kind: str
) -> None:
    low, high = BOUNDS[formula, kind]
    for block in (blocks["published_code"], other):
        area = cells_of(block)[formula, kind].area
        assert area is not None
        assert low <= area <= high


@pytest.mark.parametrize(("formula", "kind"), CLAIMS)
def test_what_is_claimed_is_reached(blocks: dict[str, Block], other: Block, formula: str, kind: str) -> None:
    for block in (blocks["published_code"], other):
        ratio = cells_of(block)[formula, kind].ratio_printed
        assert ratio == pytest.approx(1.0, abs=CLAIMS[formula, kind])


def test_one_printed_figure_is_not_reached(blocks: dict[str, Block]) -> None:
    ratio = cells_of(blocks["published_code"])["phi_p", "zonotope"].ratio_printed
    assert ratio is not None
    assert ratio > 1.1


def test_what_is_not_comparable_is_compared_with_nothing(blocks: dict[str, Block]) -> None:
    for key in ("printed_text", "ours_with_noise"):
        assert [cell.ratio_printed for cell in blocks[key].cells] == [None] * 8
    for key in ("published_code", "ours"):
        assert {k: cell.printed for k, cell in cells_of(blocks[key]).items()} == PRINTED


def test_ours_is_nowhere_larger_than_algorithm_2(blocks: dict[str, Block]) -> None:
    for key in ("ours", "ours_with_noise"):
        compared = [cell for cell in blocks[key].cells if cell.formula not in UNCUT]
        assert len(compared) == 6
        for cell in compared:
            assert cell.area is not None
            assert cell.algorithm_2 is not None
            assert cell.area <= cell.algorithm_2
            # Nor is any single set.
            assert cell.most_of_algorithm_2 is not None
            assert cell.most_of_algorithm_2 <= 1 + 1e-9
            assert cell.most_of_uncut is not None
            assert cell.most_of_uncut <= 1 + 1e-9
    published, ours = cells_of(blocks["published_code"]), cells_of(blocks["ours"])
    for formula in FORMULAS:
        # The sets are the same, so what Algorithm 2 makes of them is the cell of the published code.
        assert ours[formula.key, "zonotope"].algorithm_2 == published[formula.key, "zonotope"].area
        for kind in KINDS:
            mine, theirs = ours[formula.key, kind].area, published[formula.key, kind].area
            assert mine is not None
            assert theirs is not None
            assert mine <= theirs * (1 + 1e-9)


def test_an_exact_cut_is_nowhere_larger_than_a_zonotope_around_it(blocks: dict[str, Block]) -> None:
    for key in SIMULATED:
        found = cells_of(blocks[key])
        for formula in {cell.formula for cell in found.values()} - UNCUT:
            exact, around = found[formula, "constrained"].area, found[formula, "zonotope"].area
            assert exact is not None
            assert around is not None
            assert exact <= around * (1 + 1e-9)


def test_no_exact_cut_of_any_step_is_larger_than_its_set_or_a_zonotope_around_it(
    study: Study, other_study: Study
) -> None:
    for formula in FORMULAS:
        of_both = [one.drives(formula, models.as_published_code) for one in (study, other_study)]
        for drive in (*of_both[0], *of_both[1]):
            exact, around, published = (
                cut(drive.sets, formula, drive.at, drive.truth).sets.area()
                for cut in (cuts.our_constrained, cuts.our_zonotopes, cuts.published_constrained)
            )
            assert (exact <= around * (1 + 1e-9)).all()
            assert (exact <= published * (1 + 1e-9)).all()
            assert (around <= drive.sets.area() * (1 + 1e-9)).all()
            assert (published <= drive.sets.area() * (1 + 1e-9)).all()


def test_no_state_is_outside_but_in_the_demonstrations(blocks: dict[str, Block], other: Block) -> None:
    assert [key for key, block in blocks.items() if block.unsound] == ["demonstrations"]
    for block in (*(blocks[key] for key in SIMULATED), other):
        for cell in block.cells:
            assert cell.outside == 0
            assert (
                cell.steps
                == {NONE: 16000, NONE_RING: 5600, "phi_p": 16000, "phi_theta": 16000, "phi_r": 5600}[cell.formula]
            )


def test_the_demonstrations_lose_the_vehicle(blocks: dict[str, Block]) -> None:
    exchanged, *noisy = blocks["demonstrations"].cells
    assert len(noisy) == 2
    for cell in (exchanged, *noisy):
        assert cell.note.startswith("UNSOUND")
        assert cell.area is None
        assert cell.outside is not None
        assert cell.steps == 16000
        assert cell.outside > 0
    assert exchanged.outside is not None
    assert exchanged.outside > 0.9 * 16000


def test_the_corner_of_the_motion_region_over_the_box_of_its_error_loses_nobody(study: Study) -> None:
    """What the second demonstration leaves out, on the same kind of noise."""
    rng, track = np.random.default_rng(3), study.lot[0]
    seen = measured(track, rng)
    drive = drive_of(track, Data.of(study.before), models.as_published_code)
    for unknown, holds in ((np.zeros((2, 0)), False), (models.MEASUREMENT_NOISE, True)):
        at = replace(drive.at, last=seen.position[:-1], unknown=unknown)
        cut = cuts.published_constrained(drive.sets, PHI_THETA, at, drive.truth)
        assert cut.inside.all() == holds
        assert cut.inside.any()


def test_states_that_are_elsewhere_are_counted(study: Study) -> None:
    drives = study.drives(PHI_R, models.as_published_code)
    moved = [replace(drive, truth=drive.truth + np.array([0.0, 4.0])) for drive in drives]
    assert cells.uncut_cell(moved, NONE_RING, None).outside == 5600
    for kind in KINDS:
        assert cells.cut_cell(moved, PHI_R, kind, PUBLISHED[kind]).outside == 5600


def test_a_cell_is_the_mean_over_all_steps(study: Study) -> None:
    drives = study.drives(PHI_R, models.as_published_code)[:2]
    drives[1] = drives[1].take(np.arange(1400) < 100)
    cell = cells.cut_cell(drives, PHI_R, "zonotope", cuts.published_zonotopes, cuts.our_zonotopes)
    areas = [cuts.published_zonotopes(d.sets, PHI_R, d.at, d.truth).sets.area() for d in drives]
    assert cell.steps == 1500
    assert cell.area == pytest.approx(np.concatenate(areas).mean())
    assert cell.by_drive == pytest.approx([areas[0].mean(), areas[1].mean()])
    assert cell.uncut == pytest.approx(9.7216, abs=1e-3)
    assert cell.ratio == pytest.approx(np.concatenate(areas).mean() / cell.uncut)
    ours = [cuts.our_zonotopes(d.sets, PHI_R, d.at, d.truth).sets.area() for d in drives]
    assert cell.algorithm_2 == pytest.approx(np.concatenate(ours).mean())
    assert cell.most_of_uncut == pytest.approx(max(a.max() for a in areas) / cell.uncut)
    ratios = np.concatenate(areas) / np.concatenate(ours)
    assert cell.most_of_algorithm_2 == pytest.approx(ratios.max())
    assert cell.most_of_algorithm_2 > ratios.mean()


def test_drives_obey_their_formulas_with_room(study: Study) -> None:
    for formula in FORMULAS:
        for track in study.tracks(formula):
            assert len(track.t) == round(formula.duration * 100) + 1
            assert formula.clearance(track.t, track.position).min() >= 0.0
            step = track.position[1:] - track.position[:-1] - 0.01 * track.velocity[:-1]
            assert np.abs(step).max() < 0.002


def test_a_seed_says_everything(study: Study, blocks: dict[str, Block]) -> None:
    again = Study(0)
    for key in ("before", "ring"):
        for first, second in zip(getattr(study, key), getattr(again, key), strict=True):
            np.testing.assert_array_equal(first.position, second.position)
            np.testing.assert_array_equal(first.velocity, second.velocity)
    again.lot = study.lot
    for part in (again.published_code, again.ours_with_noise, again.demonstrations):
        block = part(lambda part: None)
        assert [replace(cell, microseconds=None) for cell in block.cells] == [
            replace(cell, microseconds=None) for cell in blocks[block.key].cells
        ]


def test_another_seed_is_another_drive(study: Study) -> None:
    seeds = [track.position[700] for track in study.ring]
    assert len({tuple(position) for position in seeds}) == 4
    np.testing.assert_array_equal(simulate(PHI_R, 1).position, study.ring[1].position)
    assert not np.array_equal(history(1)[0].position, study.before[0].position)
    assert not np.array_equal(Study(1).ring[0].position, study.ring[0].position)


def test_a_formula_that_no_drive_obeys_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet_lab.paper.drives._TRIES", 2)
    with pytest.raises(UsageError, match="none of 2 simulated drives of seed 7 satisfies φ_p"):
        simulate(PHI_P.laid_over(0.1, 1.0), 7)
