"""``Recording``: states and inputs of one vehicle over time, and how it is read from a file."""

import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import RecordingError, in_words
from fleet_bus.messages import VehicleProfile
from fleet_bus.units import canonical

FORMATS: Final = (".npz",)

_KEYS: Final = ("t", "x", "u", "seg", "x_names", "x_units", "u_names", "u_units")
_OPTIONAL_KEYS: Final = ("name", "source")


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Rows in order of time, checked once and read-only; segments stand together and are never paired across.

    Attributes:
        t: time in s (T,), strictly increasing within a segment.
        x: states (T, n), finite, in ``state_units``.
        u: inputs (T, m) in force from t on, the last ones given until then, in ``input_units``; NaN = not recorded.
        segment: number of the segment of each row (T,).
        state_names, state_units: n names and units.
        input_names, input_units: m names and units.
        name: what to call the recording.
        source: where it comes from.

    Raises ``RecordingError`` if any of this does not hold.
    """

    t: NDArray[np.float64]
    x: NDArray[np.float64]
    u: NDArray[np.float64]
    segment: NDArray[np.int64]
    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    input_names: tuple[str, ...]
    input_units: tuple[str, ...]
    name: str = "recording"
    source: str = ""

    def __post_init__(self) -> None:
        for field, kind in (("t", np.float64), ("x", np.float64), ("u", np.float64), ("segment", np.int64)):
            object.__setattr__(self, field, _frozen(getattr(self, field), kind, f"{self.name}: {field}"))
        rows = len(self.t) if self.t.ndim == 1 else -1
        n, m = len(self.state_names), len(self.input_names)
        for field, shape in (("t", (rows,)), ("x", (rows, n)), ("u", (rows, m)), ("segment", (rows,))):
            found = getattr(self, field).shape
            if found != shape or rows < 1:
                raise RecordingError(f"{self.name}: {field} has shape {found}, expected {_shape_text(shape)}")
        for what, names, units in (
            ("state", self.state_names, self.state_units),
            ("input", self.input_names, self.input_units),
        ):
            if len(units) != len(names):
                raise RecordingError(f"{self.name}: {len(names)} {what} names but {len(units)} units")
            if len(set(names)) != len(names):
                raise RecordingError(f"{self.name}: {what} names {list(names)} are not unique")
        if not np.isfinite(self.t).all() or not np.isfinite(self.x).all():
            row = int(np.argmin(np.isfinite(self.t) & np.isfinite(self.x).all(axis=1)))
            raise RecordingError(f"{self.name}: row {row} holds NaN or an infinity in t or x; remove such rows")
        if np.isinf(self.u).any():
            row = int(np.argmax(np.isinf(self.u).any(axis=1)))
            raise RecordingError(f"{self.name}: row {row} holds an infinite input; write NaN where none is known")
        self._check_order()

    def _check_order(self) -> None:
        same = self.segment[1:] == self.segment[:-1]
        stuck = same & (np.diff(self.t) <= 0)
        if stuck.any():
            row = int(np.argmax(stuck)) + 1
            raise RecordingError(
                f"{self.name}: t goes from {self.t[row - 1]} to {self.t[row]} s at row {row}, within one "
                "segment; it must increase: sort the rows, or give what follows a segment number of its own"
            )
        if np.count_nonzero(~same) + 1 != len(np.unique(self.segment)):
            raise RecordingError(f"{self.name}: the rows of a segment do not stand together; sort them by seg, then t")

    def segments(self) -> tuple[slice, ...]:
        """The rows of each segment, in order."""
        starts = [0, *(np.flatnonzero(np.diff(self.segment)) + 1).tolist(), len(self.t)]
        return tuple(slice(a, b) for a, b in pairwise(starts))

    def select(self, profile: VehicleProfile) -> "Recording":
        """The columns that ``profile`` names, in its order.

        Spellings of one unit (``m/s^2``, ``m/s2``) are the same. Raises ``RecordingError`` for a column that is not
        there or has another unit than the profile says.
        """
        states = self._columns("state", self.state_names, self.state_units, _units(profile.state))
        inputs = self._columns("input", self.input_names, self.input_units, _units(profile.inputs))
        return replace(
            self,
            x=self.x[:, states],
            u=self.u[:, inputs],
            state_names=profile.state_names,
            state_units=tuple(self.state_units[i] for i in states),
            input_names=profile.input_names,
            input_units=tuple(self.input_units[i] for i in inputs),
        )

    def _columns(
        self, what: str, names: tuple[str, ...], units: tuple[str, ...], wanted: Mapping[str, str]
    ) -> list[int]:
        missing = [name for name in wanted if name not in names]
        if missing:
            raise RecordingError(
                f"{self.name}: no {what} column {missing}; there are {list(names)}: "
                "name them so in the profile, or choose another recording"
            )
        columns = [names.index(name) for name in wanted]
        for name, i in zip(wanted, columns, strict=True):
            if canonical(units[i]) != canonical(wanted[name]):
                raise RecordingError(
                    f"{self.name}: {what} {name!r} is in {units[i]!r}, the profile says {wanted[name]!r}: "
                    "correct the profile, or convert the recording"
                )
        return columns


def load_recording(path: Path) -> Recording:
    """Recording of a file; raise ``RecordingError`` if it cannot be read or does not hold what it must.

    NPZ: arrays ``t, x, u, seg, x_names, x_units, u_names, u_units``, optionally ``name`` and ``source``;
    others are left alone. Pickled objects are never read.
    """
    if path.suffix.lower() not in FORMATS:
        raise RecordingError(
            f"{path}: {path.suffix or 'no suffix'} is not read; recordings come as {', '.join(FORMATS)}"
        )
    try:
        # np.load itself leaves a file open that turns out not to be an archive.
        with path.open("rb") as file:
            # NumPy would take it for a pickle, and advise to load that.
            if file.read(6) != np.lib.format.MAGIC_PREFIX and not zipfile.is_zipfile(file):
                raise RecordingError(f"{path}: cannot be read as NPZ: it is another kind of file, or cut off")
            file.seek(0)
            arrays = _read_arrays(np.load(file, allow_pickle=False), path)
    except RecordingError:
        raise
    except (OSError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise RecordingError(f"{path}: cannot be read as NPZ: {in_words(error)}") from None
    state_names, state_units, input_names, input_units = (
        _texts(arrays[key], f"{path}: {key}") for key in ("x_names", "x_units", "u_names", "u_units")
    )
    return Recording(
        t=arrays["t"],
        x=arrays["x"],
        u=arrays["u"],
        segment=arrays["seg"],
        state_names=state_names,
        state_units=state_units,
        input_names=input_names,
        input_units=input_units,
        name=str(arrays.get("name", path.stem)),
        source=str(arrays.get("source", "")),
    )


def _read_arrays(archive: object, path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of ``archive`` that a recording consists of, by key."""
    if not isinstance(archive, np.lib.npyio.NpzFile):
        raise RecordingError(f"{path}: holds one array, not an NPZ archive of {', '.join(_KEYS)}")
    missing = [key for key in _KEYS if key not in archive.files]
    if missing:
        raise RecordingError(f"{path}: lacks {', '.join(missing)}; it holds {', '.join(archive.files)}")
    return {key: archive[key] for key in (*_KEYS, *_OPTIONAL_KEYS) if key in archive.files}


def _frozen(array: Any, kind: type[np.generic], where: str) -> NDArray[Any]:
    found = np.asarray(array)
    if found.dtype.kind not in ("iu" if issubclass(kind, np.integer) else "fiu"):
        raise RecordingError(f"{where} holds {found.dtype}, expected {np.dtype(kind)}")
    copy: NDArray[Any] = found.astype(kind, order="C")
    copy.setflags(write=False)
    return copy


def _texts(array: NDArray[Any], where: str) -> tuple[str, ...]:
    if array.ndim != 1 or (array.dtype.kind != "U" and array.size):
        raise RecordingError(f"{where} must be a list of texts, is {array.dtype} of shape {array.shape}")
    return tuple(str(text) for text in array)


def _units(specs: Mapping[str, Any]) -> dict[str, str]:
    return {name: spec.unit for name, spec in specs.items()}


def _shape_text(shape: tuple[int, ...]) -> str:
    return f"({', '.join('T' if i == 0 else str(size) for i, size in enumerate(shape))}) with T ≥ 1 as in t"
