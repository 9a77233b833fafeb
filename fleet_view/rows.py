"""A table of numbers with a name for each row, which grows and forgets: columns are arrays, rows are reused."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Rows:
    """Columns of numbers by name; ``row(name)`` is the index at which a name stands in each of them.

    Attributes:
        columns: by name an array (capacity, ...); rows that are not in use hold the column's fill value.
        names: by row its name, None where the row is not in use.
        most: names at most; ``row`` gives None for one more.
        refused: times that a name was not taken.
    """

    def __init__(self, fill: Mapping[str, NDArray[Any]], most: int) -> None:
        self._fill = {column: np.asarray(value) for column, value in fill.items()}
        self.columns: dict[str, NDArray[Any]] = {
            column: np.repeat(value[None], 16, axis=0) for column, value in self._fill.items()
        }
        self.names: list[str | None] = [None] * 16
        self.most = most
        self.refused = 0
        self._index: dict[str, int] = {}
        self._free = list(range(15, -1, -1))

    def __len__(self) -> int:
        return len(self._index)

    def __contains__(self, name: str) -> bool:
        return name in self._index

    def __getitem__(self, column: str) -> NDArray[Any]:
        return self.columns[column]

    def row(self, name: str) -> int | None:
        """Index of a name, which gets a fresh row if it has none; None if there are too many already."""
        index = self._index.get(name)
        if index is not None:
            return index
        if len(self._index) >= self.most:
            self.refused += 1
            return None
        if not self._free:
            self._grow()
        index = self._free.pop()
        self._index[name] = index
        self.names[index] = name
        return index

    def find(self, name: str) -> int | None:
        """Index of a name; None if it has no row."""
        return self._index.get(name)

    def used(self) -> NDArray[np.intp]:
        """Indices of the rows in use."""
        return np.fromiter(self._index.values(), dtype=np.intp, count=len(self._index))

    def forget(self, names: Iterable[str]) -> None:
        """Take rows out of use; names without a row do no harm."""
        for name in names:
            index = self._index.pop(name, None)
            if index is None:
                continue
            self.names[index] = None
            self._free.append(index)
            for column, fill in self._fill.items():
                self.columns[column][index] = fill

    def _grow(self) -> None:
        old = len(self.names)
        for column, fill in self._fill.items():
            more = np.repeat(fill[None], old, axis=0)
            self.columns[column] = np.concatenate([self.columns[column], more])
        self.names += [None] * old
        self._free = list(range(2 * old - 1, old - 1, -1))
