"""Frames read back by the layout that is written down, and what of a picture is in them."""

import struct
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet_dashboard import frames
from fleet_dashboard.frames import APART, DOT, Viewport, encode
from fleet_dashboard.picture import Mark, Picture
from tests.fleet_dashboard.messages import T0, of_profile, of_state, of_tube, tube
from tests.fleet_dashboard.test_gateway import fed


@dataclass
class Frame:
    time: float
    origin: tuple[float, float]
    hidden: int
    flags: int
    rows: list[int]
    poses: list[tuple[float, ...]]
    figures: list[tuple[float, ...]]
    codes: list[int]
    #: Row, step, steps and corners in the plane.
    polygons: list[tuple[int, int, int, list[tuple[float, float]]]]


def read(raw: bytes) -> Frame:
    """A frame, number by number."""
    magic, version, time, x, y, n, p, k, hidden, flags = struct.unpack_from("<IIdddIIIII", raw)
    assert (magic, version, raw[52:64]) == (0x314D5246, 1, bytes(12))
    at = 64

    def take(code: str, count: int) -> list[float]:
        nonlocal at
        values = struct.unpack_from(f"<{count}{code}", raw, at)
        at += 4 * count
        return list(values)

    rows = [int(row) for row in take("I", n)]
    poses = list(zip(*[iter(take("f", 3 * n))] * 3, strict=True))
    figures = list(zip(*[iter(take("f", 4 * n))] * 4, strict=True))
    codes = [int(code) for code in take("I", n)]
    owners, steps = take("I", p), take("I", p)
    corners = list(zip(*[iter(take("f", 2 * p * k))] * 2, strict=True))
    assert at == len(raw)
    polygons = [
        (rows[int(owners[i])], int(steps[i]) & 0xFFFF, int(steps[i]) >> 16,
         [(x + cx, y + cy) for cx, cy in corners[i * k : (i + 1) * k]])
        for i in range(p)
    ]  # fmt: skip
    return Frame(time, (x, y), hidden, flags, rows, poses, figures, codes, polygons)


NEAR = Viewport(-2.0, -2.0, 8.0, 8.0, 100.0)


def fleet(*places: tuple[float, float], radius: float = 0.5) -> Picture:
    messages = [of_profile(f"v{i}") for i in range(len(places))]
    messages += [of_state(f"v{i}", [0, x, y, 0.5]) for i, (x, y) in enumerate(places)]
    messages += [of_tube(tube(f"v{i}", at=place, radius=radius)) for i, place in enumerate(places)]
    return fed(*messages)[1]


def test_polygons_lie_where_the_message_says() -> None:
    told = tube("v0", at=(3.0, 4.0))
    frame = read(encode(fleet((3.0, 4.0)), NEAR))
    assert frame.time == T0 / 1e9
    assert (frame.rows, frame.hidden, frame.flags) == ([0], 0, 0)
    np.testing.assert_allclose(np.add(frame.poses[0][:2], frame.origin), (3.0, 4.0), atol=1e-6)
    assert frame.poses[0][2] == 0.5
    np.testing.assert_allclose(frame.figures[0], (0.0, told.area[-1], told.area_free[-1], 0.99), rtol=1e-6)
    assert [(row, step, steps) for row, step, steps, _ in frame.polygons] == [(0, 3, 3), (0, 2, 3), (0, 1, 3)]
    for _, step, _, corners in frame.polygons:
        wanted = told.center[step - 1, :2] + told.outline[step - 1]
        np.testing.assert_allclose(corners, wanted, atol=1e-6)


def test_far_from_the_origin_polygons_are_as_exact_as_near() -> None:
    place = (6.5e6, -3.25e6)
    told = tube("v0", at=place)
    view = Viewport(place[0] - 5, place[1] - 5, place[0] + 5, place[1] + 5, 100.0)
    frame = read(encode(fleet(place), view))
    _, step, _, corners = frame.polygons[0]
    np.testing.assert_allclose(corners, told.center[step - 1, :2] + told.outline[step - 1], atol=1e-5)


def test_only_what_is_in_view_travels() -> None:
    picture = fleet((0, 0), (100, 0), (7.9, 7.9), (8.1, 0), (0, -50))
    frame = read(encode(picture, NEAR))
    # The fourth stands outside, and its sets reach into the view.
    assert frame.rows == [0, 2, 3]
    assert frame.hidden == 2
    assert {row for row, *_ in frame.polygons} == {0, 2, 3}
    assert read(encode(picture, NEAR, follow=1)).rows == [0, 1, 2, 3]


@pytest.mark.slow
@given(
    st.lists(st.tuples(st.floats(-20, 20), st.floats(-20, 20)), min_size=1, max_size=12),
    st.tuples(st.floats(-15, 15), st.floats(-15, 15), st.floats(0.5, 20), st.floats(0.5, 20)),
)
def test_culling_leaves_out_nothing_that_is_seen(
    places: list[tuple[float, float]], box: tuple[float, float, float, float]
) -> None:
    x, y, width, height = box
    picture = fleet(*places)
    view = Viewport(x, y, x + width, y + height, 50.0)
    seen = set(read(encode(picture, view)).rows)
    for row, (px, py) in enumerate(places):
        told = tube("v", at=(px, py))
        points = np.concatenate([(told.center[:, None, :2] + told.outline).reshape(-1, 2), [[px, py]]])
        inside = ((points >= (x, y)) & (points <= (x + width, y + height))).all(axis=1).any()
        if inside:
            assert row in seen
        # And what is left out or in is right by the box around all of it, but for rounding.
        low, high = points.min(axis=0), points.max(axis=0)
        gap = max(low[0] - view.x_high, view.x_low - high[0], low[1] - view.y_high, view.y_low - high[1])
        if abs(gap) > 1e-5:
            assert (row in seen) == (gap < 0)


def test_small_sets_are_thinned_and_become_dots() -> None:
    picture = fleet((0, 0))
    size = float((picture.high - picture.low).max())
    steps = [
        [step for _, step, _, _ in read(encode(picture, Viewport(-9, -9, 9, 9, pixels / size))).polygons]
        for pixels in (3.1 * APART, 1.6 * APART, 0.9 * APART, DOT * 1.1, DOT * 0.9)
    ]
    assert steps == [[3, 2, 1], [3, 1], [3], [3], []]


def test_without_a_view_all_vehicles_come_and_no_sets() -> None:
    frame = read(encode(fleet((0, 0), (1e4, 0)), None))
    assert frame.rows == [0, 1]
    assert frame.polygons == []
    assert read(encode(fleet((0, 0)), NEAR, sets=False)).polygons == []
    assert read(encode(fed()[1], None)).rows == []


def test_what_is_too_large_to_draw_has_no_polygons_but_a_place() -> None:
    frame = read(encode(fleet((1.0, 1.0), (2.0, 2.0), radius=1e37), NEAR))
    assert frame.rows == [0, 1]
    assert frame.polygons == []
    assert all(code >> 8 & Mark.TOO_LARGE for code in frame.codes)


def test_of_too_many_polygons_the_last_steps_are_left() -> None:
    picture = fleet(*((k / 10, 0) for k in range(10)))
    frames_most = frames.MOST_POLYGONS
    try:
        frames.MOST_POLYGONS = 25  # type: ignore[misc]
        found = read(encode(picture, NEAR)).polygons
    finally:
        frames.MOST_POLYGONS = frames_most  # type: ignore[misc]
    assert sorted((row, step) for row, step, *_ in found) == [(row, 3) for row in range(10)]


def test_the_past_is_told() -> None:
    assert read(encode(fleet((0, 0)), NEAR, past=True)).flags == 1
