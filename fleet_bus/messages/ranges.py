"""The range of every number in every message: decoders, encoders, JSON Schemas and docs/reference/wire.md follow it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from fleet_bus.errors import MessageError

#: Type of a pydantic error that says that a number lies outside of its range.
OUTSIDE: Final = "range"


@dataclass(frozen=True, slots=True)
class Range:
    """Numbers from ``low`` to ``high``, both allowed unless ``between`` says that only what lies between them is.

    As metadata of a pydantic field it refuses other numbers and enters the JSON Schema.
    """

    low: float
    high: float
    unit: str = ""
    between: bool = False

    def __str__(self) -> str:
        what = f"above {_text(self.low)}, below" if self.between else f"{_text(self.low)} to"
        return f"{what} {_text(self.high)} {self.unit}".rstrip()

    def __contains__(self, number: float) -> bool:
        if self.between:
            return self.low < number < self.high
        return self.low <= number <= self.high

    def holds(self, numbers: NDArray[Any]) -> bool:
        """Whether all numbers of an array lie in the range; NaN lies in none."""
        # What holds of the least and the greatest holds of all; both are NaN where one number is.
        return not numbers.size or (numbers.min() in self and numbers.max() in self)

    def check(self, name: str, number: float) -> None:
        """Raise ``MessageError("range")`` that names field, number and range unless the number lies in it."""
        if number not in self:
            raise MessageError("range", f"{name} is {number!s:.40}: expected {self}")

    def check_array(self, name: str, numbers: NDArray[Any]) -> None:
        """Raise ``MessageError`` (not_finite, range) unless all numbers of an array lie in the range."""
        if self.holds(numbers):
            return
        if numbers.dtype.kind == "f" and not np.isfinite(numbers).all():
            raise MessageError("not_finite", f"{name} holds NaN or an infinity")
        for extreme in (numbers.min(), numbers.max()):
            self.check(name, extreme.item())

    def check_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """``check_array`` of several arrays by name, at once."""
        if not self.holds(np.concatenate([numbers.ravel() for numbers in arrays.values()])):
            for name, numbers in arrays.items():
                self.check_array(name, numbers)

    def json(self) -> dict[str, float]:
        """The range in words of JSON Schema."""
        if self.between:
            return {"exclusiveMinimum": self.low, "exclusiveMaximum": self.high}
        return {"minimum": self.low, "maximum": self.high}

    def array_json(self) -> dict[str, float]:
        """The range of the numbers of an array, which JSON Schema has no words for."""
        return {f"x-{word}": limit for word, limit in self.json().items()}

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self._validated, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {**handler(schema), **self.json()}

    def _validated(self, number: float) -> float:
        if number not in self:
            raise PydanticCustomError(OUTSIDE, "expected {range}", {"range": str(self)})
        return number


def _text(number: float) -> str:
    """A limit as people write it: large whole numbers in groups, others as short as they come."""
    if isinstance(number, int):
        return f"{number:,}".replace(",", " ")
    return f"{number:g}"


#: 1 January 2200 in ns: 64 bits hold the difference of two times, and a time with any horizon added; not twice a time.
LATEST: Final = 7_258_118_400 * 10**9
#: What floats of 64 bits count exactly, which every language can.
COUNT: Final = 2**53 - 1
LONGEST_HORIZON: Final = 1000

TIME: Final = Range(1, LATEST, "ns")
EPOCH: Final = Range(0, LATEST)
SEQ: Final = Range(0, COUNT)
COUNTER: Final = Range(0, COUNT)
#: A magnitude whose square, and the square of that, is a number still.
VALUE: Final = Range(-1e30, 1e30)
SIZE: Final = Range(0.0, 1e30)
#: Magnitudes of sets fit into a float of 32 bits.
SET_VALUE: Final = Range(-1e38, 1e38)
AREA: Final = Range(0.0, 1e78)
STEP: Final = Range(1, LONGEST_HORIZON)
INDEX: Final = Range(0, 31)

STATES: Final = Range(1, 32)
INPUTS: Final = Range(0, 16)
PLAN: Final = Range(0, 512)
FLAGS: Final = Range(0, 15)
NONE: Final = Range(0, 0)
RATE: Final = Range(1e-30, 1e30)
SAMPLE_TIME: Final = Range(1e-4, 60.0, "s")
TOLERANCE: Final = Range(0.0, 1.0, between=True)
LAGS: Final = Range(0, 32)
WINDOW: Final = Range(8, 100_000)
RESERVOIR: Final = Range(0, 100_000)
NEAREST: Final = Range(1, 100_000)
CONFIDENCE: Final = Range(0.5, 1.0, between=True)
HORIZON: Final = Range(1, 200)
CLOCK_OFFSET: Final = Range(0.0, 3600.0, "s")
VERSION: Final = Range(1, COUNT)
DETAIL: Final = Range(-1e300, 1e300)
#: The times of a tube: its horizon may reach beyond the last instant that a sample may have.
AHEAD: Final = Range(1, LATEST + LONGEST_HORIZON * 60 * 10**9, "ns")
DURATION: Final = Range(0.0, 1e6, "s")
MISS: Final = Range(0.0, 1e39)
GAUGE: Final = Range(-1e30, 1e30)
#: A clock that never goes back, from any origin.
MONOTONIC: Final = Range(0.0, 1e12, "s")
#: Names, of vehicles or of sessions, that one message lists, and places among them.
LISTED: Final = Range(0, 1000)
PLACE: Final = Range(0, 999)
#: Parts of what is too large for one message.
PARTS: Final = Range(1, 16_384)

#: What a server keeps of one vehicle of a class may take this many bytes, and a tube as many as a message may have.
MEMORY: Final = Range(0, 128 * 2**20, "bytes")
TUBE_BYTES: Final = Range(0, 65_536, "bytes")

#: By document and field, as docs/reference/wire.md lists them: ``*`` stands for any name, ``[]`` for any entry. Those
#: of the binary messages stand in their lists of fields.
FIELDS: Final[Mapping[str, Mapping[str, Range]]] = {
    "VehicleProfile": {
        "state.*.limits": VALUE, "state.*.rate": RATE, "inputs.*.limits": VALUE, "inputs.*.rate": RATE,
        "sample_time": SAMPLE_TIME, "tolerance": TOLERANCE, "input_lags": LAGS, "window": WINDOW,
        "reservoir": RESERVOIR, "nearest": NEAREST, "noise.*.box": SIZE, "noise.*.generators": VALUE,
        "lipschitz.matrix": VALUE, "lipschitz.lower": VALUE, "lipschitz.upper": VALUE, "confidence": CONFIDENCE,
        "horizon": HORIZON,
    },
    "ScenarioDocument": {"version": VERSION},
    "Assignment": {"time_zero": TIME, "clock_offset": CLOCK_OFFSET},
    "Event": {"t": TIME, "details.*": DETAIL},
    "ServiceStatus": {
        "t": TIME, "started": TIME, "counters.*": COUNTER, "gauges.*": GAUGE, "refused.*": COUNTER,
        "clock_offsets.*": GAUGE, "clock_spreads.*": SIZE,
    },
}  # fmt: skip
