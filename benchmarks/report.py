"""What a benchmark hands back, and the document that a run is kept as: JSON for programs and for later runs."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    ValidationError,
    ValidationInfo,
    computed_field,
    field_serializer,
    field_validator,
)
from pydantic.dataclasses import dataclass

from fleet_bus.errors import UsageError

SUITE: Literal["fleet-reach benchmarks"] = "fleet-reach benchmarks"


def _finite(value: object) -> object:
    """JSON knows neither NaN nor infinities: None."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


Number = Annotated[float | None, BeforeValidator(_finite)]
Cell = Annotated[str | int | float | None, BeforeValidator(_finite)]


@dataclass(frozen=True)
class Claim:
    """A figure of merit and what it must be."""

    text: str
    value: Number
    relation: Literal["≥", "≤"]
    bound: float

    @computed_field  # type: ignore[prop-decorator]
    @property
    def met(self) -> bool:
        """Does the figure keep the bound? What is not a number does not."""
        if self.value is None:
            return False
        return self.value >= self.bound if self.relation == "≥" else self.value <= self.bound


@dataclass(frozen=True)
class Table:
    """Rows under ``columns``, and how they were obtained. The first ``keys`` columns name a row, and no other one."""

    title: str
    note: str
    columns: tuple[str, ...]
    rows: list[tuple[Cell, ...]]
    claims: list[Claim] = field(default_factory=list)
    keys: int = 1

    @field_validator("rows", mode="before")
    @classmethod
    def _by_column(cls, rows: Any, info: ValidationInfo) -> Any:
        columns = info.data.get("columns", ())
        return [tuple(row[c] for c in columns if c in row) if isinstance(row, dict) else row for row in rows]

    @field_validator("rows")
    @classmethod
    def _complete(cls, rows: list[tuple[Cell, ...]], info: ValidationInfo) -> list[tuple[Cell, ...]]:
        width = len(info.data.get("columns", ()))
        if any(len(row) != width for row in rows):
            raise ValueError(f"a row has not one cell for each of {width} columns")
        return rows

    @field_serializer("rows")
    def _named(self, rows: list[tuple[Cell, ...]]) -> list[dict[str, Cell]]:
        return [dict(zip(self.columns, row, strict=True)) for row in rows]

    def figures(self) -> Iterator[tuple[str, str, float]]:
        """(row, column, value) of every number that is measured."""
        for row in self.rows:
            name = ", ".join(map(str, row[: self.keys]))
            for column, cell in zip(self.columns[self.keys :], row[self.keys :], strict=True):
                if isinstance(cell, int | float):
                    yield name, column, float(cell)


class _Stored(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Conditions(_Stored):
    """Under which a run was made; ``date`` in UTC, ``load`` the mean number of busy cores in the minute before."""

    date: str
    machine: str
    cores: int
    threads: int
    load: Number
    python: str
    commit: str | None
    versions: dict[str, str]


class Outcome(_Stored):
    """What became of a benchmark; ``message`` says why it failed or was not run, ``plot`` is a path in the folder."""

    status: Literal["done", "failed", "not run"]
    message: str = ""
    seconds: Number = None
    table: Table | None = None
    plot: str | None = None


class Report(_Stored):
    """A run. ``quick``: few sets and repeats, so that figures say nothing but that it runs."""

    suite: Literal["fleet-reach benchmarks"] = SUITE
    format: Literal[1] = 1
    complete: bool
    quick: bool
    conditions: Conditions
    benchmarks: dict[str, Outcome]

    @property
    def tables(self) -> Mapping[str, Table]:
        """Tables of the benchmarks that were finished."""
        return {name: one.table for name, one in self.benchmarks.items() if one.table is not None}

    @property
    def claims(self) -> list[Claim]:
        """Claims of all benchmarks."""
        return [claim for table in self.tables.values() for claim in table.claims]

    def as_text(self) -> str:
        """The report as JSON."""
        return self.model_dump_json(indent=2) + "\n"


def read(path: Path, option: str) -> Report:
    """A report of an earlier run; raise ``UsageError`` if the file is none."""
    try:
        return Report.model_validate_json(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{option} {path}: cannot be read: {error}") from None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"])) or "the document"
        raise UsageError(f"{option} {path}: not a report of this suite: {where}: {first['msg']}") from None
