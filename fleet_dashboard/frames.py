"""One client's frame: what is in its view of a picture, as bytes that the browser reads without looking at each number.

Little-endian, every part begins at a multiple of 4 bytes:

====== ======================= ====================================================================================
offset type                    meaning
====== ======================= ====================================================================================
0      u4                      ``MAGIC``
4      u4                      version of this layout, 1
8      f8                      time of the picture, s since the Unix epoch
16     f8, f8                  origin, to which positions and corners are relative
32     u4, u4, u4              N vehicles, P polygons, K corners of each polygon
44     u4                      vehicles that are known but not in this frame
48     u4                      flags: 1 the picture is of the past
52     12 bytes                zero
64     u4 (N)                  row of each vehicle, which stands for its id
…      f4 (N, 3)               x, y, heading; NaN if not known
…      f4 (N, 4)               age (s), area and area without side information, coverage; NaN if not known
…      u4 (N)                  label, and marks times 256
…      u4 (P)                  place of the vehicle in this frame
…      u4 (P)                  step from 1, and steps of the vehicle times 65536
…      f4 (P, K, 2)            corners
====== ======================= ====================================================================================

Ids come beside it, once for each row. Vehicles whose sets are smaller than ``DOT`` pixels have no polygons; of small
ones every so manieth step is left, the last one among them.
"""

import struct
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_dashboard.picture import Picture

MAGIC: Final = 0x314D5246
VERSION: Final = 1
PAST: Final = 1
_HEADER: Final = struct.Struct("<IIdddIIIII12x")

#: Pixels below which a set is a dot, and pixels of a set's size for each step that is drawn of it: what lies closer
#: cannot be told apart.
DOT: Final = 3.0
APART: Final = 8.0
#: Polygons of one frame; beyond, all vehicles have only their last step.
MOST_POLYGONS: Final = 20_000


@dataclass(frozen=True, slots=True)
class Viewport:
    """The part of the plane that a client sees, in units of the position, and pixels to a unit."""

    x_low: float
    y_low: float
    x_high: float
    y_high: float
    pixels: float


def encode(
    picture: Picture, view: Viewport | None, *, sets: bool = True, past: bool = False, follow: int = -1
) -> bytes:
    """Frame of what is seen of a picture; without a view, every vehicle and no sets, so that a client can choose one.

    The vehicle of the row ``follow`` is always part of it.
    """
    chosen = _in_view(picture, view, follow)
    x_low, y_low, x_high, y_high = _extent(picture, chosen) if view is None else _corners(view)
    origin = np.array([(x_low + x_high) / 2, (y_low + y_high) / 2])
    with np.errstate(over="ignore", invalid="ignore"):
        pose = np.empty((len(chosen), 3), dtype="<f4")
        pose[:, :2] = picture.position[chosen] - origin
        pose[:, 2] = picture.heading[chosen]
        figures = np.stack(
            [picture.age()[chosen], picture.area[chosen], picture.area_free[chosen], picture.coverage[chosen]], axis=1
        ).astype("<f4")
    code = picture.label[chosen].astype("<u4") | picture.marks[chosen].astype("<u4") << 8
    owner, step, corners = _polygons(picture, chosen, origin, view if sets else None)
    steps = picture.steps[chosen].astype("<u4")[owner]
    header = _HEADER.pack(
        MAGIC, VERSION, picture.t / 1e9, *origin, len(chosen), len(owner), corners.shape[1],
        len(picture) - len(chosen), PAST * past,
    )  # fmt: skip
    parts = (
        chosen.astype("<u4"), pose, figures, code,
        owner.astype("<u4"), (step + 1).astype("<u4") | steps << 16, corners,
    )  # fmt: skip
    return b"".join((header, *(np.ascontiguousarray(part).data for part in parts)))


def _corners(view: Viewport) -> tuple[float, float, float, float]:
    return view.x_low, view.y_low, view.x_high, view.y_high


def _in_view(picture: Picture, view: Viewport | None, follow: int) -> NDArray[np.intp]:
    seen = np.isfinite(picture.position).all(axis=1)
    if view is not None:
        low, high = picture.low, picture.high
        seen = seen & (low[:, 0] <= view.x_high) & (high[:, 0] >= view.x_low)
        seen &= (low[:, 1] <= view.y_high) & (high[:, 1] >= view.y_low)
        if 0 <= follow < len(seen):
            seen[follow] = np.isfinite(picture.position[follow]).all()
    return np.flatnonzero(seen)


def _extent(picture: Picture, chosen: NDArray[np.intp]) -> tuple[float, float, float, float]:
    if not len(chosen):
        return 0.0, 0.0, 0.0, 0.0
    # A vehicle that is lost far away must not make all others invisible.
    position = picture.position[chosen]
    middle = np.median(position, axis=0)
    return float(middle[0]), float(middle[1]), float(middle[0]), float(middle[1])


def _polygons(
    picture: Picture, chosen: NDArray[np.intp], origin: NDArray[np.float64], view: Viewport | None
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float32]]:
    """Place of the vehicle (P,), step from 0 (P,) and corners (P, K, 2) of each polygon, the last steps first."""
    count, horizon, corners = picture.outline.shape[:3]
    none = np.zeros(0, dtype=np.intp)
    if view is None or not count:
        return none, none, np.zeros((0, corners, 2), dtype="<f4")
    with np.errstate(over="ignore", invalid="ignore"):
        size = (picture.high[chosen] - picture.low[chosen]).max(axis=1, initial=0) * view.pixels
    last = picture.steps[chosen].astype(np.intp) - 1
    # What is too large to be drawn has empty bounds, but for the place of the vehicle.
    drawn = (last >= 0) & (size >= DOT) & (picture.marks[chosen] & 16 == 0)
    step = np.arange(horizon)
    wanted = drawn[:, None] & (step <= last[:, None])
    stride = np.ceil((last + 1) / np.maximum(size / APART, 1))
    wanted &= (last[:, None] - step) % stride[:, None] == 0
    if np.count_nonzero(wanted) > MOST_POLYGONS:
        wanted &= step == last[:, None]
    # Far sets first, so that near ones lie on top.
    steps, owner = np.nonzero(wanted.T[::-1])
    steps = horizon - 1 - steps
    rows = chosen[owner]
    place = (picture.center[rows, steps] - origin).astype("<f4")
    return owner, steps, (place[:, None] + picture.outline[rows, steps]).astype("<f4", copy=False)
