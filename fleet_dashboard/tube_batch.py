"""Many tubes read at once, as far as the page draws them.

``ReachTube.decode`` checks everything and takes about 90 µs, too much for ten thousand a second. Here a tube whose form
leaves no doubt is read by its layout and its numbers are checked with those of all others; where there is any doubt,
``ReachTube.decode`` decides, and says what is wrong. Generators and hulls are not drawn and not looked at.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from typing import Any, Final

import msgpack
import numpy as np
from numpy.typing import NDArray

from fleet_bus import keys
from fleet_bus.errors import KeyIdError, MessageError
from fleet_bus.messages import Label, ReachTube, ranges
from fleet_bus.messages.tube import ENCODING, FIELDS, MAX_BYTES
from fleet_bus.pubsub import Received
from fleet_dashboard.picture import LABELS, Floats, Ints

_KEYS: Final = frozenset(field.key for field in FIELDS.fields)
#: How a map with as many entries as a tube has begins; with as many different keys none is repeated.
_HEAD: Final = bytes((0xDE, 0, len(_KEYS)))
_CODES: Final = {name: code for code, name in enumerate(LABELS[: len(Label)])}

#: The greatest numbers of an audit.
_AUDIT: Final = np.array([*[ranges.COUNTER.high] * 2, ranges.MISS.high, *[ranges.COUNTER.high] * 3])

#: Corners up to which an outline is drawn as it is, steps up to which each is; beyond, what contains them, and every so
#: manieth: what one vehicle sends must not make the arrays of all large.
MOST_CORNERS: Final = 64
MOST_STEPS: Final = 40


@dataclass(frozen=True, slots=True, eq=False)
class TubeBatch:
    """B tubes of equal layout; ``index`` (B,) says which of the messages each is.

    ``center`` (B, H, 2), ``outline`` (B, H, K, 2), ``area`` and ``area_free`` (B,) of the last step, ``label`` (B,)
    places in ``LABELS``, ``audit`` (B, 6) as in ``Audit``. What differs in length is in ``fields``: a map by short keys
    for each.
    """

    index: NDArray[np.intp]
    vehicles: list[str]
    epoch: Ints
    seq: Ints
    t: Ints
    center: Floats
    outline: NDArray[np.float32]
    area: Floats
    area_free: Floats
    label: NDArray[np.uint8]
    audit: Floats
    compute: Floats
    fields: list[Mapping[str, Any]]


def decode_tubes(messages: Sequence[Received]) -> tuple[list[TubeBatch], list[tuple[int, MessageError]]]:
    """Batches of equal layout, and ``(index, error)`` of every message that is refused."""
    groups: defaultdict[tuple[int, ...], list[tuple[int, dict[str, Any]]]] = defaultdict(list)
    doubtful: list[int] = []
    for index, message in enumerate(messages):
        fields = _unpacked(message)
        layout = None if fields is None else _layout(fields)
        if fields is None or layout is None:
            doubtful.append(index)
        else:
            groups[layout].append((index, fields))
    batches, refused = [], []
    for layout, members in groups.items():
        batch = _batch(layout, members)
        if batch is None:
            doubtful += [index for index, _ in members]
        else:
            batches.append(batch)
    for index in doubtful:
        try:
            batches.append(_one(index, messages[index]))
        except MessageError as error:
            refused.append((index, error))
    return batches, refused


def _unpacked(message: Received) -> dict[str, Any] | None:
    payload = message.payload
    if message.encoding != ENCODING or payload[:3] != _HEAD or len(payload) > MAX_BYTES:
        return None
    try:
        fields = msgpack.unpackb(payload, strict_map_key=True, max_array_len=1024, max_map_len=256, max_ext_len=0)
    except (ValueError, TypeError, RecursionError, msgpack.exceptions.UnpackException):
        return None
    if not isinstance(fields, dict) or fields.keys() != _KEYS or message.key != f"reach/{fields['v']}/tube":
        return None
    return fields


def _layout(fields: Mapping[str, Any]) -> tuple[int, ...] | None:
    """Steps, states, corners, and which states are the position; None if the form is in doubt."""
    # Written out, since it is done for each tube that comes.
    times, center, outline, area, free = fields["T"], fields["c"], fields["o"], fields["a"], fields["af"]
    names, position = fields["x"], fields["p"]
    if not type(times) is type(center) is type(outline) is type(area) is type(free) is bytes:
        return None
    if not type(names) is type(position) is list or len(position) != 2:
        return None
    first, second = position
    size, states = len(times), len(names)
    if not type(first) is type(second) is int or not (0 <= first < states and 0 <= second < states) or not size:
        return None
    corners = len(outline) // size
    if size % 8 or len(area) != size or len(free) != size or len(center) != size * states:
        return None
    if not corners or len(outline) != size * corners:
        return None
    return size // 8, states, corners, first, second


def _batch(layout: tuple[int, ...], members: list[tuple[int, dict[str, Any]]]) -> TubeBatch | None:
    """The batch of some tubes, or None if anything about one of them is doubtful."""
    steps, states, corners, first, second = layout
    fields = [each for _, each in members]
    count = len(fields)
    try:
        center = _joined(fields, "c", "<f8").reshape(count, steps, states)
        outline = _joined(fields, "o", "<f4").reshape(count, steps, corners, 2)
        area = _joined(fields, "a", "<f8").reshape(count, steps)
        free = _joined(fields, "af", "<f8").reshape(count, steps)
        numbers = np.array([(each["e"], each["s"], each["t"]) for each in fields], dtype=np.int64).reshape(count, 3)
        audit = np.array([each["au"] for each in fields], dtype=np.float64).reshape(count, 6)
        compute = np.array([each["ct"] for each in fields], dtype=np.float64).reshape(count)
        label = np.array([_CODES[each["l"]] for each in fields], dtype=np.uint8)
        texts = all(map(_sound_texts, fields))
    except (ValueError, TypeError, OverflowError, KeyError):
        return None
    sound = (
        texts
        and ranges.SET_VALUE.holds(center)
        and ranges.SET_VALUE.holds(outline)
        and ranges.AREA.holds(area)
        and ranges.AREA.holds(free)
        and (numbers >= (0, 0, 1)).all()
        and (numbers <= (ranges.EPOCH.high, ranges.SEQ.high, ranges.TIME.high)).all()
        and np.isfinite(audit).all()
        and (audit >= 0).all()
        and (audit <= _AUDIT).all()
        and (audit[:, 1] <= audit[:, 0]).all()
        and (audit[:, 4] <= audit[:, 3]).all()
        and ranges.DURATION.holds(compute)
    )
    if not sound:
        return None
    center, outline = drawable(center[:, :, [first, second]], outline)
    epoch, seq, t = numbers.T
    return TubeBatch(
        np.array([index for index, _ in members]), [each["v"] for each in fields], epoch, seq, t, center, outline,
        area[:, -1], free[:, -1], label, audit, compute, list(fields),
    )  # fmt: skip


def _sound_texts(fields: Mapping[str, Any]) -> bool:
    """Whether what is not a number has its form; numbers of steps are not looked at."""
    return (
        type(fields["v"]) is type(fields["sv"]) is str
        and type(fields["k"]) is type(fields["n"]) is list
        and type(fields["vd"]) is dict
        and all(type(cut) is list and len(cut) == 4 and type(cut[0]) is type(cut[1]) is str for cut in fields["k"])
        and all(type(note) is str for note in fields["n"])
        and all(type(name) is type(verdict) is str for name, verdict in fields["vd"].items())
    )


def _joined(fields: list[dict[str, Any]], key: str, dtype: str) -> NDArray[Any]:
    return np.frombuffer(b"".join([each[key] for each in fields]), dtype=dtype)


def _one(index: int, message: Received) -> TubeBatch:
    """The batch of one tube, after every check; raise ``MessageError``."""
    try:
        vehicle = keys.vehicle_of(message.key)
    except KeyIdError as error:
        raise MessageError("key", str(error)) from None
    tube = ReachTube.decode(message.payload, message.encoding)
    if tube.vehicle != vehicle:
        raise MessageError("key", f"a tube of {tube.vehicle} came on {message.key:.120}")
    audit = tube.audit
    center, outline = drawable(tube.center[None, :, list(tube.position)], tube.outline[None])
    fields = {
        "v": tube.vehicle, "sv": tube.server, "vd": dict(tube.verdicts), "n": list(tube.notes),
        "k": [(cut.scenario, cut.predicate, cut.first, cut.last) for cut in tube.cuts],
    }  # fmt: skip
    return TubeBatch(
        np.array([index]), [vehicle], np.array([tube.epoch]), np.array([tube.seq]), np.array([tube.t]),
        center, outline, tube.area[-1:], tube.area_free[-1:],
        np.array([_CODES[str(tube.label)]], dtype=np.uint8),
        np.array([astuple(audit)], dtype=np.float64),
        np.array([tube.compute_seconds]), [fields],
    )  # fmt: skip


def drawable(center: NDArray[Any], outline: NDArray[Any]) -> tuple[Floats, NDArray[np.float32]]:
    """Centers (B, H, 2) and outlines (B, H, K, 2) with no more steps and corners than are drawn.

    Of many steps some are left out, never the last; an outline of many corners becomes the box around it.
    """
    if center.shape[1] > MOST_STEPS:
        kept = np.unique(np.linspace(0, center.shape[1] - 1, MOST_STEPS).round().astype(int))
        center, outline = center[:, kept], outline[:, kept]
    if outline.shape[2] > MOST_CORNERS:
        bounds = np.stack([outline.min(axis=2), outline.max(axis=2)], axis=2)
        # Counter-clockwise: which bound of x and which of y each corner has.
        outline = np.stack([bounds[..., [0, 1, 1, 0], 0], bounds[..., [0, 0, 1, 1], 1]], axis=-1)
    return np.asarray(center, dtype=np.float64), np.asarray(outline, dtype=np.float32)
