"""What is drawn is what the sets are."""

from collections.abc import Iterator

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from shapely import MultiPoint, Polygon

from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, SetError, Zonotope
from reach_server.sets.plotting import AnySet, draw_bands, draw_sets, draw_tube, outlines
from tests.reach_server.ugly import directions, extreme, of

RNG = np.random.default_rng(5)
PLANAR = Zonotope(np.array([1.0, -2.0]), RNG.normal(size=(2, 5)))
CUT = ConstrainedZonotope.from_zonotope(PLANAR).intersect_strip([1.0, 0.5], 0.3, 0.4)
EMPTY = ConstrainedZonotope(np.zeros(2), np.eye(2), np.ones((1, 2)), np.array([3.0]))
SPATIAL = Zonotope(np.array([0.0, 5.0, -1.0]), RNG.normal(size=(3, 4)))
SPATIAL_CUT = ConstrainedZonotope.from_zonotope(SPATIAL).intersect_halfspace([1.0, 1.0, 1.0], 4.0)


@pytest.fixture
def axis() -> Iterator[Axes]:
    with mpl.rc_context():
        figure = Figure()
        FigureCanvasAgg(figure)
        yield figure.subplots()
        figure.canvas.draw()


def hull_of(one: AnySet, axes: tuple[int, int]) -> Polygon:
    """The projection by linear programs, across every edge found so far until none moves outwards."""
    case = of(one)

    def farthest(d: FloatArray) -> FloatArray:
        full = np.zeros(case.n)
        full[list(axes)] = d
        best = extreme(case, full)
        assert best is not None
        return best[1][list(axes)]

    hull = MultiPoint(np.array([farthest(d) for d in directions(2, 0)])).convex_hull
    while True:
        ends = np.array(hull.exterior.coords)[::-1]
        edges = np.diff(ends, axis=0)
        found = np.array([farthest(np.array([-y, x])) for x, y in edges if np.hypot(x, y) > 1e-9])
        found = np.concatenate([found, [farthest(np.array([y, -x])) for x, y in edges]])
        larger = MultiPoint(np.concatenate([ends, found])).convex_hull
        if larger.area <= hull.area * (1 + 1e-12):
            return larger
        hull = larger


@pytest.mark.parametrize(
    ("one", "axes"),
    [(PLANAR, (0, 1)), (PLANAR, (1, 0)), (CUT, (0, 1)), (CUT, (-1, 0))]
    + [(one, axes) for one in (SPATIAL, SPATIAL_CUT) for axes in ((0, 1), (0, 2), (-1, 1))],
)
@pytest.mark.slow
def test_patches_are_the_projections(axis: Axes, one: AnySet, axes: tuple[int, int]) -> None:
    (patch,) = draw_sets(axis, one, axes, facecolor="none", edgecolor="k")
    drawn = Polygon(patch.get_xy())
    truth = hull_of(one, axes)
    assert drawn.buffer(1e-7 * drawn.length).covers(truth)
    assert drawn.area == pytest.approx(truth.area, rel=1e-9)


def test_points_and_segments_are_drawn_and_empty_sets_are_not(axis: Axes) -> None:
    point = Zonotope(np.array([3.0, 4.0]), np.zeros((2, 2)))
    segment = Zonotope(np.zeros(2), np.array([[1.0, 0.5], [2.0, 1.0]]))
    assert outlines(point)[0].tolist() == [[3.0, 4.0]]
    ends = outlines(segment)[0]
    assert sorted(ends.tolist())[0] == pytest.approx([-1.5, -3.0])
    assert sorted(ends.tolist())[-1] == pytest.approx([1.5, 3.0])
    assert outlines(EMPTY)[0].shape == (0, 2)
    assert len(draw_sets(axis, [point, EMPTY, segment], label="three")) == 2
    assert list(axis.get_legend_handles_labels()[1]) == ["three"]


def test_a_batch_and_a_sequence_are_drawn_alike() -> None:
    batch = Zonotope(RNG.normal(size=(2, 3, 2)), RNG.normal(size=(2, 4)))
    places = list(np.ndindex(2, 3))
    singles = [Zonotope(batch.center[place], batch.generators) for place in places]
    for ours, theirs in zip(outlines(batch), outlines(singles), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_tube_runs_through_the_colours_and_newer_steps_lie_in_front(axis: Axes) -> None:
    steps: list[AnySet] = [PLANAR, EMPTY, CUT, CUT]
    patches = draw_tube(axis, steps, colours="plasma")
    assert len(patches) == 3
    assert [p.get_zorder() for p in patches] == sorted((p.get_zorder() for p in patches), reverse=True)
    assert patches[0].get_edgecolor() == pytest.approx(mpl.colormaps["plasma"](0.0))
    assert patches[-1].get_edgecolor() == pytest.approx(mpl.colormaps["plasma"](1.0))


def test_bands_end_at_the_interval_hull_and_leave_gaps(axis: Axes) -> None:
    times = np.array([0.0, 0.1, 0.2])
    steps: list[AnySet] = [PLANAR, EMPTY, CUT]
    _, bars = draw_bands(axis, times, steps, coordinate=1, label="y")
    wanted = [
        [[t, low], [t, high]]
        for t, one in ((0.0, PLANAR), (0.2, CUT))
        for low, high in [(one.interval_hull()[0][1], one.interval_hull()[1][1])]
    ]
    np.testing.assert_allclose(np.array(bars.get_segments()), wanted)
    assert axis.get_legend_handles_labels()[1] == ["y"]


def test_bands_of_a_batch(axis: Axes) -> None:
    batch = Zonotope(RNG.normal(size=(4, 3)), RNG.normal(size=(4, 3, 5)))
    band, bars = draw_bands(axis, range(4), batch, coordinate=-1)
    low, high = batch.interval_hull()
    np.testing.assert_allclose(np.array(bars.get_segments())[..., 1], np.stack([low[:, 2], high[:, 2]], axis=1))
    (path,) = band.get_paths()
    assert path.get_extents().ymin == pytest.approx(low[:, 2].min())
    assert path.get_extents().ymax == pytest.approx(high[:, 2].max())


def test_bad_arguments_are_named(axis: Axes) -> None:
    with pytest.raises(SetError, match=r"axes are \(0, 2\), expected two coordinates of 2"):
        draw_sets(axis, PLANAR, (0, 2))
    with pytest.raises(SetError, match=r"times has shape \(3,\), expected \(2,\)"):
        draw_bands(axis, [0.0, 0.1, 0.2], [PLANAR, CUT])
    with pytest.raises(SetError, match="coordinate is 2, the set has 2"):
        draw_bands(axis, [0.0], PLANAR, coordinate=2)
    with pytest.raises(SetError, match="times holds NaN"):
        draw_bands(axis, [np.nan], PLANAR)
