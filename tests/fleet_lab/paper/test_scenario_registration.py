"""Scenarios laid over drives, checked on drives whose best placement is known."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from shapely import Point

from fleet_lab.paper import scenario_registration as laying
from fleet_lab.paper.drives import Track, satisfies
from fleet_lab.paper.formulas import PHI_P, PHI_R, PHI_THETA, Disc, Formula, Motion, Strip
from fleet_lab.paper.scenario_registration import place, widened_motion
from fleet_lab.paper.study import Study
from reach_server.numeric.types import FloatArray
from tests.fleet_lab.paper import plane

NOTHING = np.zeros((2, 0))


def track_of(t: FloatArray, position: FloatArray) -> Track:
    """Positions over time; heading and velocity are those of the differences."""
    velocity = np.gradient(position, t, axis=0)
    return Track("synthetic", t, position, np.arctan2(*velocity.T[::-1]), velocity)


def moved(track: Track, angle: float, shift: FloatArray, size: float = 1.0, pace: float = 1.0) -> Track:
    """A track as if it were driven elsewhere, larger, slower; every fifth sample, from another time on."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return Track(
        "moved", 77.0 + pace * track.t[::5], size * track.position[::5] @ turn.T + shift, track.heading[::5] + angle,
        size / pace * track.velocity[::5] @ turn.T,
    )  # fmt: skip


def fits(formula: Formula, track: Track) -> None:
    """The placement found makes the track satisfy the formula."""
    placement = place(formula, track)
    assert placement is not None
    laid, there = formula.laid_over(placement.size, placement.stretch), placement.track(track)
    assert there.t[0] == 0.0
    assert there.t[-1] == pytest.approx(laid.duration, abs=0.06)
    clearance = laid.clearance(there.t, there.position)
    assert np.isfinite(clearance).all()
    assert clearance.min() >= 0.9 * laying._CLEAR


@pytest.mark.parametrize("degrees", [0, 70, 250])
def test_a_drive_that_satisfies_a_formula_after_a_motion_needs_no_enlargement(study: Study, degrees: int) -> None:
    """Backwards by 10° steps: the very motion is among those tried."""
    for formula, tracks in ((PHI_R, study.ring), (PHI_P, study.lot)):
        track = moved(tracks[0], np.radians(degrees), np.array([30.0, -12.0]))
        placement = place(formula, track)
        assert placement is not None
        assert placement.size == pytest.approx(1.0)
        assert placement.stretch == 1.0
        assert (placement.begin, placement.end) == (0, len(track.t))
        fits(formula, track)


def test_a_drive_that_is_too_large_enlarges_the_regions(study: Study) -> None:
    track = moved(study.ring[1], 1.3, np.array([-4.0, 9.0]), size=2.0)
    placement = place(PHI_R, track)
    assert placement is not None
    # Regions of twice the size hold it, but for the rotation between those tried; smaller ones by much do not.
    assert 1.5 < placement.size < 2.3
    fits(PHI_R, track)


@pytest.mark.parametrize("radius", [0.4, 1.0, 2.5])
def test_the_size_is_the_least(radius: float) -> None:
    """A circle in one disc and one strip: both sizes follow by hand."""
    t = np.arange(0.0, 10.0001, 0.05)
    angle = 2 * np.pi * t / 5
    track = track_of(t, np.array([5.0, 5.0]) + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    disc = Formula("disc", "D", 10.0, (), (Disc("disc", (0.3, 0.1), 0.7, 0.0, 10.0),))
    strip = Formula("strip", "S", 10.0, (Strip("strip", (0.0, 1.0), -0.4, 0.7, 0.0, 10.0),))
    for formula, inner in ((disc, np.cos(np.pi / 32)), (strip, 1.0)):
        placement = place(formula, track)
        assert placement is not None
        assert placement.size == pytest.approx(max(1.0, (radius + 1e-3) / (0.7 * inner)), rel=2e-3)
        assert placement.stretch == 1.0
        fits(formula, track)


def test_a_short_drive_gets_shorter_windows(study: Study) -> None:
    track = moved(study.ring[0], 0.0, np.zeros(2), pace=0.55)
    placement = place(PHI_R, track)
    assert placement is not None
    assert placement.stretch == 0.5
    fits(PHI_R, track)


def test_a_long_drive_is_taken_from_where_it_fits_best(study: Study) -> None:
    """First a drive that needs regions of twice the size, then one that needs none larger."""
    large, fitting = moved(study.ring[0], 0.0, np.zeros(2), size=2.0), moved(study.ring[0], 0.0, np.zeros(2))
    t = np.concatenate([large.t, 14.05 + fitting.t])
    track = track_of(t, np.concatenate([large.position, fitting.position]))
    placement = place(PHI_R, track)
    assert placement is not None
    assert placement.size == pytest.approx(1.0)
    assert placement.begin == len(large.t)
    fits(PHI_R, track)
    first = place(PHI_R, replace(track, t=large.t, position=large.position))
    assert first is not None
    assert first.size > 1.5


def test_what_cannot_be_is_not_placed(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(laying, "_ROTATIONS", 6)
    monkeypatch.setattr(laying, "_STARTS", 2)
    ring = moved(study.ring[0], 0.0, np.zeros(2))
    assert place(PHI_R, replace(ring, t=77.0 + 0.05 * (ring.t - 77.0))) is None
    # 300 m between any two samples: too large in however short a window.
    t = np.arange(0.0, 20.0, 0.05)
    jumps = np.column_stack([300.0 * np.arange(float(len(t))) ** 1.5, np.zeros(len(t))])
    assert place(PHI_R, track_of(t, jumps)) is None


def sliding(slip: float, length: float, headings: FloatArray) -> Track:
    """Each step goes ``length`` m at an angle ``slip`` rad to the left of the heading."""
    direction = headings + slip
    steps = length * np.column_stack([np.cos(direction), np.sin(direction)])
    position = np.zeros((len(steps) + 1, 2))
    position[1:] = np.cumsum(steps, axis=0)
    t = 0.01 * np.arange(float(len(position)))
    return Track("sliding", t, position, np.append(headings, 0.0), np.zeros_like(position))


HEADINGS = np.linspace(-3, 3, 25)


@pytest.mark.parametrize(("slip", "degrees"), [(0.0, 20), (15.0, 20), (-19.9, 20), (20.1, 21), (-44.5, 45), (79.5, 80)])
def test_the_motion_region_is_widened_by_as_many_degrees_as_it_takes(slip: float, degrees: int) -> None:
    track = sliding(np.radians(slip), 0.02, HEADINGS)
    found = widened_motion(Motion(), track, NOTHING)
    assert found is not None
    assert found.diagonal == Motion().diagonal
    assert found.turn == pytest.approx(np.radians(degrees))
    for turn, inside in ((found.turn, True), (found.turn - np.radians(1.0), degrees == 20)):
        for k in range(len(HEADINGS)):
            region = plane.motion_region(Motion(turn=turn), track.position[k], float(track.heading[k]))
            distance = region.distance(Point(track.position[k + 1]))
            if not inside:
                assert distance > 1e-6
            elif turn == found.turn:
                assert distance < 1e-12
    assert satisfies(Formula("motion", "T", 1.0, (), motion=found), track)


def test_steps_that_no_motion_region_holds() -> None:
    for slip, length in ((81.0, 0.02), (180.0, 0.001), (0.0, 0.7)):
        assert widened_motion(Motion(), sliding(np.radians(slip), length, HEADINGS), NOTHING) is None
    # Straight on, longer steps than the diagonal are in no parallelogram of it.
    assert widened_motion(Motion(), sliding(0.0, 0.64, HEADINGS), NOTHING) is not None


def test_what_is_unknown_of_the_corner_counts() -> None:
    """A car that stands, with an error of its measured position, is in T(x) only over the box of that error."""
    rng = np.random.default_rng(0)
    position = 0.001 * rng.uniform(-1, 1, (50, 2))
    track = Track("standing", 0.01 * np.arange(50.0), position, np.zeros(50), np.zeros((50, 2)))
    assert widened_motion(Motion(), track, NOTHING) is None
    # Two positions are off, one bound is for both.
    found = widened_motion(Motion(), track, 0.002 * np.eye(2))
    assert found == replace(Motion(), turn=np.radians(20))
    assert widened_motion(Motion(), track, 0.0002 * np.eye(2)) is None


def test_a_formula_with_a_motion_region_is_placed_by_its_regions(study: Study) -> None:
    track = moved(study.lot[0], 0.0, np.zeros(2))
    found = [place(formula, track) for formula in (PHI_P, PHI_THETA)]
    assert found[0] is not None
    assert found[1] is not None
    assert asdict(found[0]) == asdict(found[1])
