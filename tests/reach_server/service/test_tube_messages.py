"""Rounding to float32 only enlarges what is sent."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus.messages import Audit, Cut, Event, EventKind, Label, ReachTube, parse_profile
from reach_server.service.tube_messages import messages, outward_box, outward_generators
from reach_server.sets.raw import RawSets
from reach_server.tube.summaries import summarize
from tests.reach_server.tube.test_summaries import PLANE, none_act, strips
from tests.reach_server.ugly import assert_outlines, directions, moderate

scales = st.sampled_from([1e-30, 1e-12, 1e-3, 1.0, 1e6, 1e12])


@moderate
@given(st.integers(0, 2**32 - 1), scales)
def test_rounded_boxes_hold_the_exact_ones(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    bounds = np.sort(scale * rng.normal(size=(3, 2, 4)), axis=1)
    sent = outward_box(bounds)
    np.testing.assert_array_equal(sent, sent.astype(np.float32))
    assert (sent[:, 0] <= bounds[:, 0]).all()
    assert (sent[:, 1] >= bounds[:, 1]).all()
    np.testing.assert_allclose(sent, bounds, rtol=3e-7)


@moderate
@given(st.integers(0, 2**32 - 1), scales, st.integers(0, 4))
def test_rounded_zonotopes_hold_the_exact_ones(seed: int, scale: float, extra: int) -> None:
    rng = np.random.default_rng(seed)
    diagonal = np.abs(rng.normal(size=(5, 3, 1))) * np.eye(3) * (rng.random((5, 1, 1)) < 0.7)
    generators = scale * np.concatenate([rng.normal(size=(5, 3, extra)), diagonal], axis=2)
    sent = outward_generators(generators)
    np.testing.assert_array_equal(sent, sent.astype(np.float32))
    d = np.concatenate([directions(3, 20), np.sign(directions(3, 20, 1))])
    exact, rounded = np.abs(d @ generators).sum(axis=-1), np.abs(d @ sent).sum(axis=-1)
    assert (rounded >= exact * (1 - 1e-14)).all()
    assert (rounded <= exact + 1e-6 * (np.abs(d) @ np.abs(generators)).sum(axis=-1) + 1e-43).all()


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_messages_hold_the_sets_after_their_round_trip(scale: float) -> None:
    from reach_server.engine.results import Tubes

    rng = np.random.default_rng(0)
    center = np.array([[5e6, -3e5, 1.0], [0.0, 0.0, 0.0]])
    G = scale * rng.normal(size=(2, 3, 9)) * np.array([1.0, 1.0, 1e-3])[:, None]
    sets = RawSets.zonotope(center, G)
    figure = summarize(sets, np.repeat(none_act(), 2, axis=0), strips(), PLANE)
    ids = np.array([1, 1], dtype=np.uint64)
    times = np.array([[2], [2]], dtype=np.int64)
    tubes = Tubes(
        ("a", "b"), ids, ids, np.array([1, 1]), times, (sets,), (sets,), figure.area[:, None], figure.area[:, None],
        figure.outline()[:, None], figure.hull[:, None], (Label.GUARANTEED,) * 2, ("set_membership",) * 2,
        ((), ()), ((), ()), ({}, {"s.stays": "satisfied"}), (), {},
    )  # fmt: skip
    sent = list(
        messages(tubes, ("x", "y", "z"), PLANE, [Audit(), Audit(3, 2, 0.5, 3, 2, 1)], server="s", server_epoch=1,
                 compute_seconds=0.0)
    )  # fmt: skip
    assert [m.vehicle for m in sent] == ["a", "b"]
    factors = np.sign(rng.uniform(-1, 1, (300, 9)))
    d = directions(3, 40)
    for row, message in enumerate(sent):
        came = ReachTube.decode(message.encode())
        np.testing.assert_array_equal(came.center[0], center[row])
        points = factors @ G[row].T
        assert_outlines(came.outline[0], points[:, :2], scale)
        assert (came.hull[0, 0] <= points).all()
        assert (points <= came.hull[0, 1]).all()
        assert (np.abs(d @ came.generators[0]).sum(axis=1) >= (points @ d.T).max(axis=0)).all()
    assert sent[1].verdicts == {"s.stays": "satisfied"}
    assert sent[1].audit == Audit(3, 2, 0.5, 3, 2, 1)


@pytest.mark.parametrize(("cuts", "verdicts"), [(3, 2), (500, 2), (3, 500), (2000, 2000)])
def test_a_message_lists_as_many_names_as_it_has_room_for(cuts: int, verdicts: int) -> None:
    from reach_server.engine.results import Tubes
    from reach_server.service.tube_messages import CUTS_LEFT_OUT, VERDICTS_LEFT_OUT

    horizon, n = 200, 4
    profile = parse_profile(
        {"class": "c", "state": {f"x{i}": "m" for i in range(n)}, "sample_time": 1, "horizon": horizon}
    )
    sets = RawSets.zonotope(np.zeros((1, n)), np.eye(n)[None])
    one, each = np.array([1]), np.ones((1, horizon))
    named = tuple(Cut("s" * 64, f"{i}.{'p' * 60}", 1, horizon) for i in range(cuts))
    told = {f"{'s' * 64}.{i}": "undecided (time)" for i in range(verdicts)}
    tubes = Tubes(
        ("a",), one.astype(np.uint64), one.astype(np.uint64), one, np.ones((1, horizon), dtype=np.int64),
        (sets,) * horizon, (sets,) * horizon, each, each, np.zeros((1, horizon, 12, 2)), np.zeros((1, horizon, 2, n)),
        (Label.GUARANTEED,), ("lti",), (named,), (("rank deficient",),), (told,), (), {},
    )  # fmt: skip
    (message,) = messages(
        tubes, profile.state_names, (0, 1), [Audit()], server="s", server_epoch=1, compute_seconds=0.0
    )
    came = ReachTube.decode(message.encode())
    assert came.cuts == named[: len(came.cuts)]
    assert came.verdicts.items() <= told.items()
    assert len(came.cuts) >= min(cuts, 18)
    assert len(came.verdicts) >= min(verdicts, 18)
    left_out = [CUTS_LEFT_OUT] * (len(came.cuts) < cuts) + [VERDICTS_LEFT_OUT] * (len(came.verdicts) < verdicts)
    assert came.notes == ("rank deficient", *left_out)
    assert bool(left_out) == (cuts + verdicts > 5)


def test_an_event_says_as_much_as_a_message_has_room_for() -> None:
    from reach_server.data.events import EngineEvent

    found = EngineEvent(
        EventKind.CONTRADICTION, "a", 1, "\u0100" * 5000, {"predicate": "\u0100" * 50_000, "elapsed": 1.0}
    )
    event = Event(
        kind=found.kind, vehicle=found.vehicle, t=found.t, source="s", message=found.message, details=found.details
    )
    assert Event.decode(event.encode()) == event
