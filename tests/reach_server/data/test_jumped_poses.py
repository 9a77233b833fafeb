"""Poses that jump or stand still although the vehicle moves: what is a jump follows from what was seen before."""

from dataclasses import replace

import numpy as np
import pytest

from reach_server.data.pose_jumps import LEAST_LINKS, SEEN_CHANGE
from reach_server.data.window import AppendReport, SampleBatch, Window
from reach_server.numeric.types import FloatArray
from tests.reach_server.data.circles import ALL, circle, moved, profile, run_of, window


def jump(w: Window, k: int, offset: FloatArray) -> SampleBatch:
    """The next sample after k - 1, shifted, and the one after it."""
    batch = circle(2, k)
    return replace(batch, x=batch.x + offset)


def shifted(k: int, offset: list[float]) -> SampleBatch:
    """Sample k, shifted."""
    batch = circle(1, k)
    return replace(batch, x=batch.x + np.array(offset))


@pytest.mark.parametrize(
    ("offset", "breaks"),
    [([1.0, 0, 0, 0], True), ([0, -0.8, 0, 0], True), ([0.3, 0, 0, 0], False), ([0, 0, 0, 5.0], False),
     ([0, 0, 0.7, 0], True), ([0, 0, 2 * np.pi, 0], False), ([0, 0, 0.3, 0], False)],
)  # fmt: skip
def test_a_pose_that_no_change_before_explains_begins_a_trajectory(offset: list[float], breaks: bool) -> None:
    w = window()
    w.append(circle(80))
    batch = jump(w, 80, np.array(offset))
    found = w.append(batch)
    assert found.jumped == (((0, int(batch.t[0])),) if breaks else ())
    assert found.stored == 2
    assert run_of(w)[-2:] == ([0, 1] if breaks else [80, 81])


def test_few_links_say_nothing_about_jumps() -> None:
    w = window()
    w.append(circle(LEAST_LINKS))
    assert not w.append(jump(w, LEAST_LINKS, np.array([50.0, 0, 0, 0]))).jumped


def test_what_the_speed_says_is_no_jump() -> None:
    w = window()
    parked = replace(circle(80), x=np.zeros((80, 4)) + 1e-6 * np.random.default_rng(0).normal(size=(80, 4)))
    w.append(parked)
    away = replace(circle(1, 80), x=np.array([[0.01, 0, 0, 0.1]]))
    assert not w.append(away).jumped
    further = replace(circle(1, 81), x=np.array([[1.01, 0, 0, 0.1]]))
    assert w.append(further).jumped


def test_a_stated_rate_says_what_a_jump_is() -> None:
    states = {"x": "m", "y": "m", "yaw": {"unit": "rad", "angle": True}, "v": {"unit": "m/s", "limits": [-1.0, 2.0]}}
    w = window(profile(state=states))
    w.append(circle(5))
    # 2 m/s in 50 ms, doubled, is 0.2 m.
    assert not w.append(jump(w, 5, np.array([0.0, 0.14, 0, 0]))).jumped
    assert w.append(shifted(7, [0.3, 0.3, 0, 0])).jumped
    noisy = profile(state=states, noise={"measurement": {"box": [0.1, 0.1, 0.1, 0.1]}})
    w = window(noisy)
    w.append(circle(5))
    assert not w.append(shifted(5, [0.3, 0.3, 0, 0])).jumped
    rated = profile(state=states | {"v": {"unit": "m/s", "rate": 5.0}})
    w = window(rated)
    w.append(circle(5))
    assert not w.append(shifted(5, [0, 0, 0, 0.4])).jumped
    assert w.append(shifted(6, [0, 0, 0, 1.0])).jumped


def test_without_roles_every_state_is_watched() -> None:
    plain = profile(frame="world", roles={}, state={"a": "m", "b": "m", "c": {"unit": "rad", "angle": True}, "d": "m"})
    w = window(plain)
    w.append(circle(80))
    assert not w.append(jump(w, 80, np.array([0.0, 0, 0, 1.0]))).jumped, "what never changed says nothing"
    wave = circle(80)
    w = window(plain)
    w.append(replace(wave, x=wave.x + 0.01 * np.sin(np.arange(80.0))[:, None]))
    assert w.append(jump(w, 80, np.array([0.0, 0, 0, 1.0]))).jumped


def test_a_pose_repeated_while_moving_is_no_transition() -> None:
    w = window()
    w.append(circle(60))
    batch = circle(4, 60)
    held = moved(batch, 0, np.r_[w.block(ALL, 1).x[0, 0, :3], 1.0])
    held = moved(held, 1, held.x[0])
    assert w.append(held) == AppendReport(4, frozen_pose=2)
    assert run_of(w)[58:] == [58, 59, 0, 0, 0, 1]


def test_a_parked_car_repeats_its_pose_honestly() -> None:
    w = window()
    w.append(circle(60))
    parked = circle(20, 60)
    parked = replace(parked, x=np.tile(np.r_[parked.x[0, :3], 0.0], (20, 1)))
    assert w.append(parked) == AppendReport(20)
    assert run_of(w)[-1] == 79
    nearly = circle(20, 80)
    nearly = replace(nearly, x=np.tile(np.r_[parked.x[0, :3], 0.01], (20, 1)))
    assert w.append(nearly) == AppendReport(20)


def test_the_largest_change_decides_not_the_typical_one() -> None:
    w = window()
    batch = circle(80)
    w.append(moved(batch, 40, batch.x[40] + [0.05, 0.0, 0.0, 0.0]))
    largest = float(np.hypot(*np.diff(w.block(ALL, 80).x[0, :, :2], axis=0).T).max())
    for share, jumps in ((0.9, False), (1.1, True)):
        w.append(circle(1, 80))
        start = w.block(ALL, 1).x[0, 0]
        offset = np.array([share * SEEN_CHANGE * largest, 0.0, 0.0, 0.0])
        seq = int(w.newest(ALL)[1][0]) + 1
        assert bool(w.append(replace(circle(1, seq), x=(start + offset)[None])).jumped) is jumps
        w = window()
        w.append(moved(batch, 40, batch.x[40] + [0.05, 0.0, 0.0, 0.0]))
