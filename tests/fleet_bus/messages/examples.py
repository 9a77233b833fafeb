"""One good example, or a strategy of them, for each message."""

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from numpy.typing import NDArray

from fleet_bus import codec, keys
from fleet_bus.errors import MessageError
from fleet_bus.messages import (
    Assignment,
    Audit,
    CheckpointPart,
    Cut,
    Document,
    Event,
    EventKind,
    JournalRound,
    Label,
    ReachTube,
    ScenarioDocument,
    ServiceStatus,
    StateFlag,
    StateSample,
    VehicleProfile,
    parse_profile,
    ranges,
)
from fleet_bus.messages import checkpoint as checkpoint_message
from fleet_bus.messages import journal as journal_message
from fleet_bus.messages import state as state_message
from fleet_bus.messages import tube as tube_message
from fleet_bus.messages.journal import Call
from fleet_bus.messages.methods import TUBE_METHODS
from fleet_bus.messages.ranges import Range

T0 = 1_700_000_000_000_000_000

ids = st.from_regex(keys.ID_PATTERN, fullmatch=True)


def whole(span: Range) -> st.SearchStrategy[int]:
    """Integers of a range."""
    return st.integers(int(span.low), int(span.high))


def numbers(span: Range, width: Literal[32, 64] = 64) -> st.SearchStrategy[float]:
    """Floats of a range, its ends among them; of ``width`` bits, inside of it."""
    low, high = (float(np.float32(0.999 * end)) if width == 32 else end for end in (span.low, span.high))
    return st.floats(low, high, width=width)


stamps = whole(ranges.TIME)
epochs, seqs = whole(ranges.EPOCH), whole(ranges.SEQ)
finite = numbers(ranges.VALUE)
halves = numbers(ranges.SIZE)


def arrays(shape: tuple[int, ...], elements: st.SearchStrategy[float] = finite) -> st.SearchStrategy[NDArray[Any]]:
    return npst.arrays(np.float64, shape, elements=elements)


@st.composite
def samples(draw: st.DrawFn, n: int | None = None, m: int | None = None) -> StateSample:
    n = draw(st.integers(1, 6)) if n is None else n
    m = draw(st.integers(0, 3)) if m is None else m
    steps = draw(st.integers(0, 5))
    flags = StateFlag(draw(st.integers(0, 15)) & ~StateFlag.BOUND)
    bound = draw(st.none() | arrays((n,), halves))
    return StateSample(
        draw(epochs),
        draw(seqs),
        draw(stamps),
        draw(arrays((n,))),
        draw(arrays((m,))),
        flags if bound is None else flags | StateFlag.BOUND,
        bound,
        draw(arrays((steps, m))) if steps else None,
        draw(arrays((m,), halves)) if steps else None,
    )


@st.composite
def tubes(draw: st.DrawFn) -> ReachTube:
    h, n, g, k = (draw(st.integers(*bounds)) for bounds in ((1, 5), (1, 4), (0, 6), (0, 12)))
    single, double, areas = numbers(ranges.SET_VALUE, 32), numbers(ranges.SET_VALUE), numbers(ranges.AREA)
    texts = st.text(max_size=20)
    checked = draw(st.integers(0, 2**40))
    recent = draw(st.integers(0, min(checked, 1000)))
    index = st.integers(0, n - 1)
    return ReachTube(
        draw(ids),
        draw(epochs),
        draw(seqs),
        draw(stamps),
        draw(npst.arrays(np.int64, (h,), elements=whole(ranges.AHEAD))),
        tuple(draw(st.lists(texts, min_size=n, max_size=n))),
        (draw(index), draw(index)),
        draw(st.sampled_from(TUBE_METHODS)),
        draw(st.sampled_from(Label)),
        draw(arrays((h, n), double)),
        draw(arrays((h, n, g), single)),
        draw(arrays((h, 2, n), single)),
        draw(arrays((h, k, 2), single)),
        draw(arrays((h,), areas)),
        draw(arrays((h,), areas)),
        tuple(draw(st.lists(st.builds(Cut, texts, texts, st.integers(1, h), st.integers(1, h)), max_size=3))),
        tuple(draw(st.lists(texts, max_size=3))),
        draw(st.dictionaries(texts, texts, max_size=3)),
        Audit(
            checked,
            draw(st.integers(0, checked)),
            draw(numbers(ranges.MISS)),
            recent,
            draw(st.integers(0, recent)),
            draw(st.integers(0, recent)),
        ),
        draw(texts),
        draw(epochs),
        draw(numbers(ranges.DURATION)),
    )


def a_sample(**changes: Any) -> StateSample:
    fields = {"epoch": 3, "seq": 7, "t": T0, "x": np.array([1.0, 2.0, 0.5, 0.3]), "u": np.array([0.1, 0.4])}
    return StateSample(**{**fields, **changes})


def a_tube(**changes: Any) -> ReachTube:
    h, n = 3, 4
    fields = {
        "vehicle": "svea1",
        "epoch": 3,
        "seq": 7,
        "t": T0,
        "times": T0 + 50_000_000 * np.arange(1, h + 1),
        "state_names": ("x", "y", "yaw", "v"),
        "position": (0, 1),
        "method": "set_membership",
        "label": Label.GUARANTEED,
        "center": np.arange(h * n, dtype=float).reshape(h, n),
        "generators": np.broadcast_to(0.5 * np.eye(n), (h, n, n)),
        "hull": np.stack([np.full((h, n), -0.5), np.full((h, n), 0.5)], axis=1),
        "outline": np.broadcast_to([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]], (h, 4, 2)),
        "area": np.ones(h),
        "area_free": np.full(h, 2.0),
        "cuts": (Cut("parking-lot", "P.x1", 1, 3),),
        "notes": ("rank deficient",),
        "audit": Audit(10, 9, 0.25, 10, 9, 3),
        "server": "reach-1",
        "server_epoch": T0,
        "compute_seconds": 0.01,
    }
    return ReachTube(**{**fields, **changes})


def a_round(**changes: Any) -> JournalRound:
    fields = {
        "server": "reach-1", "server_epoch": T0, "build": "0011223344556677", "number": 12, "now": 3.5, "stamp": T0,
        "part": (1, 2), "idle": np.array([3.46, 3.48]), "vehicles": ("svea1", "svea2"), "sessions": ("4f",),
        "calls": (
            Call("document", 3.5, "spec/parking-lot/document", "5a", "00ff00ff00ff00ff"), Call("process", 3.5),
            Call("elapse", 3.5),
        ),
        "sample_vehicle": np.array([0, 1, 0], dtype="<u2"), "sample_session": np.zeros(3, dtype="<u2"),
        "arrived": np.array([T0, 0, T0 + 1]), "sample_digest": b"12345678" * 3,
        "tube_vehicle": np.array([1], dtype="<u2"), "tube_epoch": np.array([3]), "tube_seq": np.array([7]),
        "tube_digest": b"abcdefgh", "event_digest": b"ABCDEFGH" * 2, "note": "published 0.6 s late", "failed": "",
        "totals": (300, 200, 1), "chain": "0123456789abcdef" * 2,
    }  # fmt: skip
    return JournalRound(**{**fields, **changes})


def a_part(**changes: Any) -> CheckpointPart:
    fields = {
        "server": "reach-1", "server_epoch": T0, "build": "0011223344556677", "number": 12,
        "chain": "0123456789abcdef" * 2, "digest": "fedcba9876543210" * 2, "part": (2, 3), "data": b"state",
    }  # fmt: skip
    return CheckpointPart(**{**fields, **changes})


def profile_fields() -> dict[str, Any]:
    """A document that uses every field."""
    return {
        "class": "svea",
        "state": {"x": "m", "y": "m", "yaw": {"unit": "rad", "angle": True}, "v": "m/s"},
        "inputs": {
            "steering": {"unit": "rad", "limits": [-0.7, 0.7], "rate": 3.0},
            "velocity": {"unit": "m/s", "limits": [-1.7, 1.7], "rate": 4},
        },
        "sample_time": "50 ms",
        "tolerance": 0.3,
        "frame": "body",
        "input_lags": 1,
        "window": 1000,
        "noise": {
            "process": {"box": [0.01, 0.01, 0.02, 0.05], "origin": "given"},
            "measurement": {"generators": [[0.01, 0], [0.01, 0], [0, 0.01], [0, 0.02]], "origin": "given"},
        },
        "lipschitz": {"lower": [[-1.0] * 5] * 4, "upper": [[1.0] * 5] * 4, "origin": "given"},
        "future_inputs": "rate",
        "confidence": 0.99,
        "roles": {"position": ["x", "y"], "heading": "yaw", "speed": "v", "steering": "steering"},
        "horizon": 10,
        "method": "default",
        "cuts": "zonotope",
        "maps_to": {"x1": "x", "x2": "y"},
    }


def a_profile() -> VehicleProfile:
    return parse_profile(profile_fields())


def documents() -> tuple[Document, ...]:
    return (
        a_profile(),
        ScenarioDocument(scenario="parking-lot", version=1, text="scenario: parking-lot\n"),
        Assignment(scenario="parking-lot", vehicle="svea1", time_zero=T0, clock_offset=0.01),
        Event(
            kind=EventKind.MISS,
            vehicle="svea1",
            t=T0,
            source="reach-1",
            message="the measured state lay outside",
            details={"excess": 0.5, "step": 1, "first": True, "predicate": "P.x1"},
        ),
        ServiceStatus(
            kind="reach",
            instance="reach-1",
            t=T0 + 1,
            started=T0,
            counters={"states": 5},
            gauges={"vehicles": 1.0},
            refused={"shape": 1},
            chain={"value": "0123456789abcdef" * 2, "round": "12"},
        ),
    )


Decoder = Callable[[bytes], object]


def messages() -> dict[str, tuple[bytes, Decoder, str, int]]:
    """By name: payload of a good example, decoder, encoding and greatest number of bytes."""
    found: dict[str, tuple[bytes, Decoder, str, int]] = {
        type(d).__name__: (d.encode(), type(d).decode, type(d).encoding(), type(d).MAX_BYTES) for d in documents()
    }
    found["StateSample"] = (a_sample().encode(), StateSample.decode, state_message.ENCODING, state_message.MAX_BYTES)
    found["ReachTube"] = (a_tube().encode(), ReachTube.decode, tube_message.ENCODING, tube_message.MAX_BYTES)
    found["JournalRound"] = (
        a_round().encode(), JournalRound.decode, journal_message.ENCODING, journal_message.MAX_BYTES,
    )  # fmt: skip
    found["CheckpointPart"] = (
        a_part().encode(), CheckpointPart.decode, checkpoint_message.ENCODING, checkpoint_message.MAX_BYTES,
    )  # fmt: skip
    return found


def refusal(decode: Callable[..., object], *arguments: Any, **options: Any) -> str:
    """Reason of the refusal; fails if there is none, or another error."""
    with pytest.raises(MessageError) as caught:
        decode(*arguments, **options)
    assert caught.value.reason in codec.REASONS
    assert str(caught.value) == f"{caught.value.reason}: {caught.value.detail}"
    assert len(str(caught.value)) < 2000
    return caught.value.reason


def reason_or_none(decode: Callable[..., object], *arguments: Any, **options: Any) -> str | None:
    """Reason of the refusal, or None if there is none."""
    try:
        decode(*arguments, **options)
    except MessageError as error:
        return error.reason
    return None
