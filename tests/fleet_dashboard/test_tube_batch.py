"""Tubes read many at once: what ``ReachTube.decode`` reads of each, and what it refuses."""

from dataclasses import replace

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus.errors import MessageError
from fleet_bus.messages import Audit, Cut, Label, ReachTube
from fleet_bus.messages.tube import ENCODING
from fleet_bus.pubsub import Received
from fleet_dashboard.picture import LABELS
from fleet_dashboard.tube_batch import MOST_CORNERS, MOST_STEPS, decode_tubes
from tests.fleet_dashboard.messages import T0, of_tube, tube


def changed(message: Received, **fields: object) -> Received:
    """A tube with other values of some short keys."""
    packed = msgpack.unpackb(message.payload)
    packed |= fields
    return replace(message, payload=msgpack.packb(packed))


def test_a_batch_holds_what_the_tubes_hold() -> None:
    tubes = [
        tube("a", at=(1.0, 2.0), seq=3, label=Label.CALIBRATED, verdicts={"lot.r": "satisfied"}),
        tube("b", steps=5, corners=6, cuts=[Cut("lot", "P", 1, 4)], label=Label.CONTRADICTED),
        tube("c", at=(-4.0, 1e7), seq=9, audit=Audit(7, 5, 2.5, 7, 5, 1)),
    ]
    batches, refused = decode_tubes([of_tube(each) for each in tubes])
    assert refused == []
    assert sorted(len(batch.index) for batch in batches) == [1, 2]
    for batch in batches:
        for row, index in enumerate(batch.index.tolist()):
            wanted = ReachTube.decode(of_tube(tubes[index]).payload)
            assert batch.vehicles[row] == wanted.vehicle
            assert (batch.epoch[row], batch.seq[row], batch.t[row]) == (wanted.epoch, wanted.seq, wanted.t)
            np.testing.assert_array_equal(batch.center[row], wanted.center[:, list(wanted.position)])
            np.testing.assert_array_equal(batch.outline[row], wanted.outline)
            assert batch.area[row] == wanted.area[-1]
            assert batch.area_free[row] == wanted.area_free[-1]
            assert LABELS[batch.label[row]] == wanted.label
            audit = wanted.audit
            assert batch.audit[row].tolist() == [
                audit.checked, audit.inside, audit.last_miss, audit.recent, audit.recent_inside, audit.band,
            ]  # fmt: skip
            assert batch.fields[row]["vd"] == dict(wanted.verdicts)
            assert [tuple(cut) for cut in batch.fields[row]["k"]] == [
                (cut.scenario, cut.predicate, cut.first, cut.last) for cut in wanted.cuts
            ]


GOOD = of_tube(tube("a"))
STEPS, STATES, CORNERS = 3, 4, 8


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (replace(GOOD, encoding="application/msgpack;fleet.tube.v2"), "version"),
        (replace(GOOD, encoding="application/json"), "encoding"),
        (replace(GOOD, payload=b""), "malformed"),
        (replace(GOOD, payload=GOOD.payload[:-3]), "malformed"),
        (replace(GOOD, payload=b"\xde\x00\x16" + bytes(70_000)), "too_large"),
        (replace(GOOD, key="reach/b/tube"), "key"),
        (replace(GOOD, key="reach/a b/tube"), "key"),
        (changed(GOOD, o=bytes(7)), "shape"),
        (changed(GOOD, T=b""), None),
        (changed(GOOD, x=["x", "y"]), None),
        (changed(GOOD, p=[0, 9]), None),
        (changed(GOOD, p=[0, True]), None),
        (changed(GOOD, l="certain"), "range"),
        (changed(GOOD, c=np.full((STEPS, STATES), np.nan).tobytes()), "not_finite"),
        (changed(GOOD, c=np.full((STEPS, STATES), 1e300).tobytes()), "range"),
        (changed(GOOD, o=np.full((STEPS, CORNERS, 2), np.inf, dtype="<f4").tobytes()), "not_finite"),
        (changed(GOOD, a=np.full(STEPS, -1.0).tobytes()), "range"),
        (changed(GOOD, au=[1, 2, 0.0, 1, 1, 1]), "range"),
        (changed(GOOD, au=[1, 1]), None),
        (changed(GOOD, e=2**64 - 1), "range"),
        (changed(GOOD, s=-1), "range"),
        (changed(GOOD, t=0), "range"),
        (changed(GOOD, vd=["lot"]), "fields"),
        (changed(GOOD, vd={"lot.r": 1}), None),
        (changed(GOOD, k=[1]), None),
        (changed(GOOD, k=[["lot", "P", 1]]), None),
        (changed(GOOD, k=[["lot", {}, 1, 2]]), None),
        (changed(GOOD, n=[1]), None),
        (changed(GOOD, sv=1), "fields"),
        (changed(GOOD, au=[2**63, 1, 0.0, 1, 1, 1]), "range"),
        (changed(GOOD, extra=1), "fields"),
    ],
)
def test_what_the_decoder_refuses_is_refused_beside_good_ones(message: Received, reason: str | None) -> None:
    others = [of_tube(tube("before")), of_tube(tube("after"))]
    batches, refused = decode_tubes([others[0], message, others[1]])
    assert sorted(vehicle for batch in batches for vehicle in batch.vehicles) == ["after", "before"]
    ((index, error),) = refused
    assert index == 1
    if message.key == GOOD.key:
        with pytest.raises(MessageError) as wanted:
            ReachTube.decode(message.payload, message.encoding)
        assert error.reason == wanted.value.reason
    assert reason in (None, error.reason)


def test_a_repeated_key_is_refused() -> None:
    packed = msgpack.unpackb(GOOD.payload)
    items = [*packed.items()]
    body = b"".join(msgpack.packb(part) for pair in [*items, ("l", "calibrated")] for part in pair)
    for payload in (b"\xde\x00\x17" + body, b"\xde\x00\x16" + body):
        batches, refused = decode_tubes([replace(GOOD, payload=payload)])
        assert batches == []
        assert [error.reason for _, error in refused] == ["malformed"]


def test_another_form_of_msgpack_is_read_all_the_same() -> None:
    packed = msgpack.unpackb(GOOD.payload)
    body = b"".join(msgpack.packb(part) for pair in packed.items() for part in pair)
    batches, refused = decode_tubes([replace(GOOD, payload=b"\xdf\x00\x00\x00\x16" + body)])
    assert refused == []
    assert [batch.vehicles for batch in batches] == [["a"]]


@pytest.mark.slow
@given(st.binary(max_size=200), st.integers(0, 200))
def test_no_bytes_make_it_fail(raw: bytes, place: int) -> None:
    payload = GOOD.payload[:place] + raw + GOOD.payload[place + len(raw) :]
    message = replace(GOOD, payload=payload)
    batches, refused = decode_tubes([message])
    assert sum(len(batch.index) for batch in batches) + len(refused) == 1
    try:
        wanted: ReachTube | None = ReachTube.decode(payload, ENCODING)
    except MessageError:
        wanted = None
    if wanted is not None and wanted.vehicle == "a":
        assert refused == []
        np.testing.assert_array_equal(batches[0].center[0], wanted.center[:, list(wanted.position)])


def test_a_long_tube_keeps_its_last_step_and_a_round_one_is_boxed() -> None:
    long = tube("a", steps=200, corners=4)
    (batch,), _ = decode_tubes([of_tube(long)])
    assert batch.outline.shape == (1, MOST_STEPS, 4, 2)
    np.testing.assert_array_equal(batch.center[0, -1], long.center[-1, :2])
    assert batch.area[0] == long.area[-1]
    (batch,), _ = decode_tubes([of_tube(tube("a", steps=1, corners=MOST_CORNERS + 1, radius=2.0))])
    box = batch.outline[0, 0]
    assert len(box) == 4
    edges = np.roll(box, -1, axis=0) - box
    for point in tube("a", steps=1, corners=MOST_CORNERS + 1, radius=2.0).outline[0]:
        away = point - box
        assert (edges[:, 0] * away[:, 1] - edges[:, 1] * away[:, 0] >= -1e-6).all()


def test_times_are_those_of_the_samples() -> None:
    (batch,), _ = decode_tubes([of_tube(tube("a", t=T0 + 5))])
    assert batch.t.tolist() == [T0 + 5]
