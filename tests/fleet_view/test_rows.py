"""Rows by name: growth, reuse, bounds."""

import numpy as np

from fleet_view.rows import Rows


def table(most: int = 1000) -> Rows:
    return Rows({"at": np.asarray(-np.inf), "pair": np.zeros(2, dtype=np.int64)}, most)


def test_a_row_keeps_its_values_while_others_come() -> None:
    rows = table()
    for i in range(100):
        index = rows.row(f"car{i}")
        assert index is not None
        rows["at"][index] = i
        rows["pair"][index] = i, 2 * i
    assert len(rows) == 100
    for i in range(100):
        index = rows.find(f"car{i}")
        assert index is not None
        assert rows["at"][index] == i
        assert rows["pair"][index].tolist() == [i, 2 * i]
        assert rows.names[index] == f"car{i}"
    assert len(set(rows.used().tolist())) == 100


def test_a_row_that_is_used_again_is_empty() -> None:
    rows = table(most=2)
    first, second = rows.row("a"), rows.row("b")
    assert first is not None
    rows["at"][first] = 7.0
    assert rows.row("c") is None
    assert rows.refused == 1
    rows.forget(["a", "nobody"])
    assert "a" not in rows
    third = rows.row("c")
    assert third is not None
    assert third != second
    assert rows["at"][third] == -np.inf
    assert rows.used().tolist() == [second, third]
    assert rows.names.count(None) == len(rows.names) - 2
