"""``VehicleProfile``: what a server must know about a vehicle class before it may say anything about it."""

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from fleet_bus.errors import ProfileError, in_words
from fleet_bus.messages import ranges
from fleet_bus.messages.documents import Document, Id, explain
from fleet_bus.messages.methods import CutMethod, Method
from fleet_bus.units import seconds

Origin = Literal["given", "calibrated"]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]{0,31}$")]
Value = Annotated[float, ranges.VALUE]
Matrix = list[list[Value]]
# Documents have lists only.
Limits = Annotated[tuple[Value, Value], Field(strict=False)]
Position = Annotated[tuple[Name, Name], Field(strict=False)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


def _as_unit(value: object) -> object:
    return {"unit": value} if isinstance(value, str) else value


def _seconds(value: object) -> float:
    # Of a number it is told what is wrong with it as of any other.
    return value if isinstance(value, float) else seconds(value)


class _Quantity(_Part):
    unit: Annotated[str, Field(max_length=16)]
    limits: Limits | None = None
    rate: Annotated[float, ranges.RATE] | None = None

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.limits is not None and not self.limits[0] <= self.limits[1]:
            raise ValueError(f"limits {list(self.limits)} are reversed")
        return self


class StateSpec(_Quantity):
    """One state: its unit, whether it is an angle that wraps, and what holds of it whatever the data says: its limits,
    and how fast it can change (unit per second); None where not known."""

    angle: bool = False


class InputSpec(_Quantity):
    """One input: unit, actuator limits and rate limit (unit per second), None where not known."""


class NoiseSet(_Part):
    """A bounded noise set around zero: ``box`` half-widths (n), or a generator matrix (n rows)."""

    box: list[Annotated[float, ranges.SIZE]] | None = None
    generators: Matrix | None = None
    origin: Origin = "calibrated"

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.box is None) == (self.generators is None):
            raise ValueError("give either box (half-widths) or generators (one row per state)")
        if self.generators is not None and len(lengths := {len(row) for row in self.generators}) > 1:
            raise ValueError(f"rows of generators must have one length, theirs are {sorted(lengths)}")
        return self

    def matrix(self) -> NDArray[np.float64]:
        """Generator matrix (n, g)."""
        if self.box is not None:
            return np.diag(np.array(self.box))
        return np.array(self.generators, dtype=np.float64)


class Noise(_Part):
    """Process noise (in the frame of the model) and measurement noise (error of the published state)."""

    process: NoiseSet | None = None
    measurement: NoiseSet | None = None


class Lipschitz(_Part):
    """Bounds of the partial derivatives of one step, columns as ``VehicleProfile.regressors`` lists them.

    Either ``lower`` and ``upper`` bound the derivatives of the true dynamics (in the frame of the model), or
    ``matrix`` bounds their magnitude; with ``of: residual`` it bounds those of dynamics minus fitted model.
    """

    matrix: Matrix | None = None
    lower: Matrix | None = None
    upper: Matrix | None = None
    of: Literal["dynamics", "residual"] = "dynamics"
    origin: Origin = "calibrated"

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        interval = self.lower is not None and self.upper is not None
        if interval == (self.matrix is not None) or (self.lower is None) != (self.upper is None):
            raise ValueError("give either matrix, or lower and upper")
        if interval and self.of == "residual":
            raise ValueError("lower and upper bound the dynamics; for the residual give matrix")
        return self


class Roles(_Part):
    """Which states and inputs mean what; needed by ``frame: body``."""

    position: Position | None = None
    heading: Name | None = None
    speed: Name | None = None
    steering: Name | None = None
    lateral_speed: Name | None = None
    yaw_rate: Name | None = None


class VehicleProfile(Document):
    """State, inputs, timing, noise and method of a vehicle class (docs: reference/wire, profile)."""

    SCHEMA: ClassVar[str] = "fleet.profile"

    vehicle_class: Annotated[Id, Field(alias="class")]
    state: dict[Name, Annotated[StateSpec, BeforeValidator(_as_unit)]] = Field(min_length=1, max_length=32)
    inputs: dict[Name, Annotated[InputSpec, BeforeValidator(_as_unit)]] = Field(default_factory=dict, max_length=16)
    sample_time: Annotated[float, BeforeValidator(_seconds), ranges.SAMPLE_TIME, Field(description="s")]
    tolerance: Annotated[float, ranges.TOLERANCE, Field(description="of a sample time")] = 0.3
    frame: Literal["world", "body"] = "world"
    input_lags: Annotated[int, ranges.LAGS] = 0
    window: Annotated[int, ranges.WINDOW] = 1000
    reservoir: Annotated[int, ranges.RESERVOIR, Field(description="older samples kept beside the window")] = 0
    nearest: Annotated[int, ranges.NEAREST, Field(description="data that bound the residual on a vehicle's way")] = 64
    noise: Noise = Noise()
    lipschitz: Lipschitz | None = None
    future_inputs: Literal["limits", "rate", "plan", "learned"] = "rate"
    filtered: Annotated[bool, Field(description="intersect a received state with what was predicted for it")] = False
    confidence: Annotated[float, ranges.CONFIDENCE] = 0.99
    margin: Annotated[Literal["step", "tube"], Field(description="what the confidence speaks about")] = "step"
    roles: Roles = Roles()
    horizon: Annotated[int, ranges.HORIZON] = 10
    method: Literal["default", Method] = "default"
    cuts: CutMethod = "zonotope"
    maps_to: dict[Name, Name] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        n = len(self.state)
        for what, noise in (("process", self.noise.process), ("measurement", self.noise.measurement)):
            if noise is not None:
                rows = noise.matrix()
                if rows.ndim != 2 or rows.shape[0] != n:
                    raise ValueError(f"noise.{what} has {len(rows)} rows, the state has {n}: {list(self.state)}")
        for role, names in self.roles.model_dump(exclude_none=True).items():
            for name in (names,) if isinstance(names, str) else names:
                pool = self.inputs if role == "steering" else self.state
                if name not in pool:
                    raise ValueError(f"roles.{role} names {name!r}, which is none of {list(pool)}")
        for ours, theirs in self.maps_to.items():
            if theirs not in self.state:
                raise ValueError(f"maps_to.{ours} names {theirs!r}, which is none of the states {list(self.state)}")
        if self.frame == "body":
            if self.roles.position is None or self.roles.heading is None:
                raise ValueError("frame: body needs roles.position and roles.heading")
            if not self.state[self.roles.heading].angle:
                raise ValueError(f"roles.heading names {self.roles.heading!r}, which is not marked angle: true")
        # The columns depend on the roles, which are known to be sound here.
        if self.lipschitz is not None:
            shape = (n, len(self.regressors))
            for what, matrix in self.lipschitz.model_dump(include={"matrix", "lower", "upper"}).items():
                if matrix is not None and [len(row) for row in matrix] != [shape[1]] * n:
                    raise ValueError(
                        f"lipschitz.{what} has rows of the lengths {[len(row) for row in matrix]}, expected {shape}: "
                        f"rows {list(self.state)}, columns {list(self.regressors)}"
                    )
        if self.future_inputs in ("limits", "rate"):
            for name, spec in self.inputs.items():
                if spec.limits is None:
                    raise ValueError(f"future_inputs: {self.future_inputs} needs inputs.{name}.limits")
                if self.future_inputs == "rate" and spec.rate is None:
                    raise ValueError(f"future_inputs: rate needs inputs.{name}.rate (or choose future_inputs: limits)")
        return self

    @model_validator(mode="after")
    def _affordable(self) -> Self:
        if self.memory not in ranges.MEMORY:
            raise PydanticCustomError(
                ranges.OUTSIDE,
                "a vehicle of this class takes up to {size} MiB of a server's memory, {most} MiB are allowed: lower "
                "window, reservoir, nearest, input_lags or horizon",
                {"size": self.memory // 2**20 + 1, "most": int(ranges.MEMORY.high) // 2**20},
            )
        if self.tube_bytes not in ranges.TUBE_BYTES:
            raise PydanticCustomError(
                ranges.OUTSIDE,
                "a tube of {horizon} steps with {n} states takes {size} bytes, {range} are allowed: lower the horizon",
                {
                    "horizon": self.horizon,
                    "n": len(self.state),
                    "size": self.tube_bytes,
                    "range": str(ranges.TUBE_BYTES),
                },
            )
        return self

    @property
    def memory(self) -> int:
        """Bytes that a server keeps of one vehicle: an outer bound, whatever the method."""
        n, m, p, lags, steps = len(self.state), len(self.inputs), len(self.regressors), self.input_lags, self.horizon
        held = self.window + lags + steps + 2
        window = held * (8 * (n + m) + 64)
        # What bounds the residual function: data, the reservoir behind it, the nearest ones, sums of products.
        rows = 2 * (held + 2 * self.reservoir + self.nearest)
        bounded = 8 * (rows * (p + n + 3) + 2 * (p + n + 2) ** 2)
        # The calibrated model: each step's increments on all features, its errors and their scores.
        features = 1 + 8 * n + 4 + (lags + 1) * (m + 1) + (steps - 1) * (m + 1) * (self.future_inputs == "plan")
        scores = held * (steps + 1) * (2 * n + 8)
        calibrated = 8 * (2 * features**2 + 2 * features * (steps + 1) * n) + scores + 64 * steps * (4 * n + m + 8)
        return window + max(bounded, calibrated)

    @property
    def tube_bytes(self) -> int:
        """Bytes of the longest tube of this class: an outer bound, names of what cut it up to 4 KiB included."""
        n = len(self.state)
        # Per step: time, center, n + 2 generators, box, an outline of 12 vertices, two areas; all in single or double.
        return self.horizon * (8 + 8 * n + 4 * n * (n + 2) + 8 * n + 96 + 16) + 34 * n + 8192

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states, in order."""
        return tuple(self.state)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs, in order."""
        return tuple(self.inputs)

    @property
    def sample_time_ns(self) -> int:
        """Sample time in nanoseconds."""
        return round(self.sample_time * 1e9)

    @property
    def angles(self) -> NDArray[np.bool_]:
        """Mask (n) of the states that wrap."""
        return np.array([spec.angle for spec in self.state.values()])

    @property
    def position(self) -> tuple[int, int]:
        """Indices of the two position states (the first two states where no role says otherwise)."""
        if self.roles.position is None:
            return (0, min(1, len(self.state) - 1))
        first, second = (self.state_names.index(name) for name in self.roles.position)
        return (first, second)

    @property
    def heading(self) -> int | None:
        """Index of the heading state, or None."""
        return None if self.roles.heading is None else self.state_names.index(self.roles.heading)

    @property
    def regressors(self) -> tuple[str, ...]:
        """Columns of the model after the constant: the states it depends on, then the inputs by lag."""
        pose = {*(self.roles.position or ()), self.roles.heading} if self.frame == "body" else set()
        states = [name for name in self.state if name not in pose]
        lagged = [f"{name}[k-{lag}]" if lag else name for lag in range(self.input_lags + 1) for name in self.inputs]
        return (*states, *lagged)

    @property
    def guaranteed(self) -> bool:
        """Whether every bound that a guarantee rests on is stated by the user (``origin: given``)."""
        stated = (self.noise.process, self.noise.measurement, self.lipschitz)
        return all(part is not None and part.origin == "given" for part in stated)

    def shape_key(self) -> tuple[Any, ...]:
        """What two profiles must share so that their vehicles share arrays."""
        return (self._packed(),)


def parse_profile(fields: object, source: str = "profile") -> VehicleProfile:
    """Profile of a parsed YAML document; raise ``ProfileError`` naming ``source`` and the place."""
    if not isinstance(fields, dict):
        raise ProfileError(f"{source}: a map is expected, {type(fields).__name__} came")
    try:
        return VehicleProfile.model_validate(fields)
    except ValidationError as error:
        raise ProfileError(f"{source}: {explain(error)}") from None


def load_profile(path: Path) -> VehicleProfile:
    """Profile of a YAML file; raise ``ProfileError`` if it cannot be read or is not a profile."""
    try:
        fields = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ProfileError(f"{path}: cannot be read: {in_words(error)}") from None
    # Beyond its own errors, PyYAML lets through what dates that do not exist and deep nesting lead to.
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ProfileError(f"{path}: not YAML: {error}") from None
    return parse_profile(fields, str(path))
