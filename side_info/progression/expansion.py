"""Alternatives of many obligations at once, as flat arrays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from side_info.progression.alternatives import Tableau
from side_info.progression.obligations import Obligations

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Expansion:
    """Alternatives of R obligations, A in all, those of one obligation next to each other.

    ``obligation`` (R,) are those asked about. ``start`` (R + 1,): alternatives ``start[r]`` to ``start[r + 1] - 1``
    belong to ``obligation[r]``; ``parent`` (A,) says the same from the other side. ``literal_set`` (A,) numbers sets of
    literals (``Table.masks`` tells what is in them) and ``next`` (A,) is the obligation from the next sample on.
    """

    obligation: Ints
    start: Ints
    parent: Ints
    literal_set: Ints
    next: Ints


class Expander:
    """Expansion by lookup: only obligations that were never seen cost a loop."""

    def __init__(self, obligations: Obligations, tableau: Tableau) -> None:
        self._obligations = obligations
        self._tableau = tableau
        self._ways = _Lists(self._list_ways)
        self._pairs = _Lists(self._list_pairs)
        self._literal_sets: dict[int, int] = {}
        self._holds = _Rows(np.zeros((0, 64), dtype=np.bool_))

    def expand(self, obligations: Ints) -> Expansion:
        """Alternatives of the obligations (R,)."""
        obligations = np.asarray(obligations, dtype=np.int64)
        start, parent, found = self._ways.gather(obligations)
        return Expansion(obligations, start, parent, found[:, 0], found[:, 1])

    def masks(self, literal_sets: Ints, count: int) -> Bools:
        """(A, count): whether literal set a has literal l in it, for the literals below ``count``."""
        if count > self._holds.array.shape[1]:
            self._widen(count)
        held: Bools = self._holds.array[np.asarray(literal_sets, dtype=np.int64), :count]
        return held

    def subsumption(self, expansion: Expansion) -> tuple[Ints, Ints]:
        """Pairs (i, j) of alternatives of one row, where the next obligation of i entails that of j.

        Alternative i may be dropped if the literals of j that i lacks hold on the whole set of the row: the set of j
        has that of i in it then. So may all such i at once, even where j is among them: the pairs are transitive and
        without cycles, so that one stays whose set has all of theirs in it.
        """
        _, row, found = self._pairs.gather(expansion.obligation)
        first = expansion.start[row]
        return first + found[:, 0], first + found[:, 1]

    def _list_ways(self, obligation: int) -> list[tuple[int, int]]:
        return [(self._literal_set(literals), rest) for literals, rest in self._tableau.ways(obligation)]

    def _list_pairs(self, obligation: int) -> list[tuple[int, int]]:
        rests = [rest for _, rest in self._tableau.ways(obligation)]
        count = len(rests)
        entails = np.array(
            [[self._obligations.entails(one, other) for other in rests] for one in rests], dtype=np.bool_
        )
        for middle in range(count):
            entails |= entails[:, middle, None] & entails[None, middle, :]
        # Of alternatives that mean the same the first one stays.
        goes = entails & ~(entails.T & np.triu(np.ones((count, count), dtype=np.bool_)))
        return [(int(i), int(j)) for i, j in np.argwhere(goes)]

    def _literal_set(self, literals: int) -> int:
        number = self._literal_sets.get(literals)
        if number is None:
            if literals.bit_length() > self._holds.array.shape[1]:
                self._widen(literals.bit_length())
            row = np.array([[literals >> i & 1 for i in range(self._holds.array.shape[1])]], dtype=np.bool_)
            number = self._literal_sets[literals] = self._holds.append(row)
        return number

    def _widen(self, count: int) -> None:
        more = max(count - self._holds.array.shape[1], self._holds.array.shape[1])
        self._holds = _Rows(np.pad(self._holds.array, ((0, 0), (0, more))))


class _Lists:
    """Lists of pairs of integers by number, one after the other in one array; found out when first asked for."""

    def __init__(self, find: Callable[[int], Sequence[tuple[int, int]]]) -> None:
        self._find = find
        self._first: Ints = np.zeros(0, dtype=np.int64)
        self._count: Ints = np.zeros(0, dtype=np.int64)
        self._entries = _Rows(np.zeros((0, 2), dtype=np.int64))

    def gather(self, numbers: Ints) -> tuple[Ints, Ints, Ints]:
        """The lists of the numbers (R,): where each begins (R + 1,), and for each entry its row (A,) and it (A, 2)."""
        self._see(numbers)
        count = self._count[numbers]
        start = np.zeros(len(numbers) + 1, dtype=np.int64)
        np.cumsum(count, out=start[1:])
        row = np.repeat(np.arange(len(numbers)), count)
        position = np.arange(start[-1]) + np.repeat(self._first[numbers] - start[:-1], count)
        return start, row, self._entries.array[position]

    def _see(self, numbers: Ints) -> None:
        """Find out what was never asked for."""
        beyond = int(numbers.max(initial=-1)) + 1 - len(self._count)
        if beyond > 0:
            more = max(beyond, len(self._count))
            self._first = np.pad(self._first, (0, more))
            self._count = np.pad(self._count, (0, more), constant_values=-1)
        unseen = numbers[self._count[numbers] < 0]
        for number in np.unique(unseen).tolist() if len(unseen) else ():
            found = self._find(number)
            self._first[number] = self._entries.append(np.array(found, dtype=np.int64).reshape(-1, 2))
            self._count[number] = len(found)


class _Rows:
    """A growing array."""

    def __init__(self, rows: NDArray[Any]) -> None:
        self._room = rows
        self._size = len(rows)

    @property
    def array(self) -> NDArray[Any]:
        return self._room[: self._size]

    def append(self, rows: NDArray[Any]) -> int:
        """Append rows and return the number of the first one."""
        first, self._size = self._size, self._size + len(rows)
        if self._size > len(self._room):
            more = max(len(self._room), self._size - len(self._room), 64)
            self._room = np.concatenate([self._room, np.zeros((more, *self._room.shape[1:]), dtype=self._room.dtype)])
        self._room[first : self._size] = rows
        return first
