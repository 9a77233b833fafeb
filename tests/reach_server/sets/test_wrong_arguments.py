"""What is no argument of a set or of its verbs is refused with a message that names it."""

import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from reach_server.sets import ConstrainedZonotope, SetError, Zonotope
from tests.reach_server.sets.verbs import BATCH, ROWS, TWO, VERBS, AnySet, Each, G, N, at, both, sets


@dataclass(frozen=True, eq=False)
class Wrong:
    """An argument of a verb, a bad value, and what the message must say."""

    verb: str
    argument: str
    value: Any
    says: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.verb}, {self.argument}: {self.says[-1]}"


def _wrong() -> list[Wrong]:
    nan, inf = np.nan, np.inf
    shapes = [
        Wrong("box", "lower", 1.0, ("()", "expected")),
        Wrong("box", "lower", [0.0, 0.0, 0.0], ("(3,)", "(..., 2)")),
        Wrong("box", "lower", [5.0, 0.0], ("greater",)),
        Wrong("point", "x", 1.0, ("()", "expected")),
        Wrong("point", "x", [], ("(0,)", "dimension")),
        Wrong("linear_map", "matrix", np.ones((2, 5)), ("(2, 5)", "(..., …, 2)")),
        Wrong("linear_map", "matrix", np.ones(2), ("(2,)", "(..., …, 2)")),
        Wrong("linear_map", "matrix", np.ones((0, 2)), ("(0, 2)", "dimension")),
        Wrong("linear_map", "matrix", np.ones((7, 1, 2)), ("(7,)", "(2, 3)")),
        Wrong("affine_map", "offset", np.ones(5), ("(5,)", "(..., 3)")),
        Wrong("scale", "factor", np.ones(7), ("(7,)", "(2, 3)")),
        Wrong("translate", "offset", np.ones(5), ("(5,)", "(..., 2)")),
        Wrong("project", "axes", (0, 2), ("(0, 2)", "2")),
        Wrong("project", "axes", (), ("()",)),
        Wrong("minkowski_sum", "other", sets(Zonotope, 1, 3), ("3", "2")),
        Wrong("convex_hull", "other", sets(Zonotope, 1, 3), ("3", "2")),
        Wrong("intersection", "other", sets(Zonotope, 1, 3), ("3", "2")),
        Wrong("intersection", "matrix", np.ones((2, 5)), ("(2, 5)", "2")),
        Wrong("intersection", "matrix", np.ones((3, 2)), ("(3, 2)", "2")),
        Wrong("contains_set", "other", sets(Zonotope, 1, 3), ("3", "2")),
        Wrong("intersects", "other", sets(Zonotope, 1, 3), ("3", "2")),
        Wrong("intersect_strip", "H", np.ones(5), ("(5,)", "(..., 2)")),
        Wrong("intersect_strip", "q", np.ones(7), ("(7,)", "(2, 3)")),
        Wrong("intersect_strip", "r", np.ones(7), ("(7,)", "(2, 3)")),
        Wrong("intersect_strip", "r", -0.5, ("negative", "-0.5")),
        Wrong("intersect_halfspace", "H", np.ones(5), ("(5,)", "(..., 2)")),
        Wrong("intersect_halfspace", "q", np.ones(7), ("(7,)", "(2, 3)")),
        Wrong("intersect_tangents", "H", np.ones((4, 5)), ("(4, 5)", "(..., …, 2)")),
        Wrong("intersect_tangents", "q", np.ones(5), ("(5,)", "(..., 4)")),
        Wrong("intersect_linearised", "J", np.ones(5), ("(5,)", "(..., 2)")),
        Wrong("intersect_linearised", "h0", np.ones(7), ("(7,)", "(2, 3)")),
        Wrong("intersect_linearised", "r", -0.5, ("negative", "-0.5")),
        Wrong("intersect_linearised", "remainder", (1.0, 0.0), ("lower", "upper")),
        Wrong("intersect_linearised", "remainder", (nan, 1.0), ("NaN",)),
        Wrong("from_interval", "interval", ([2.0, 0.0], [1.0, 1.0]), ("lower", "upper")),
        Wrong("reduce_order", "order", nan, ("nan",)),
        Wrong("reduce_order", "order", -1.0, ("-1",)),
        Wrong("reduce_order", "method", "best", ("best", "girard")),
        Wrong("support", "d", np.ones(2), ("(2,)", "(..., …, 2)")),
        Wrong("support", "d", np.ones((4, 3)), ("(4, 3)", "(..., …, 2)")),
        Wrong("support", "d", np.ones((7, 4, 2)), ("(7,)", "(2, 3)")),
        Wrong("contains_point", "x", np.ones(3), ("(3,)", "(..., 2)")),
        Wrong("contains_point", "x", np.ones((7, 2)), ("(7,)", "(2, 3)")),
        Wrong("factors_of", "x", np.ones(3), ("(3,)", "(..., 2)")),
        Wrong("polygon", "count", 2, ("2", "3")),
        Wrong("sample", "count", -1, ("-1",)),
        *(Wrong(name, "other", np.ones(2), ("ndarray", "Zonotope")) for name in TWO),
        Wrong("sample", "how", "everywhere", ("everywhere", "inside")),
    ]
    kinds = {v.name: v for v in VERBS}
    filled = []
    for verb in kinds.values():
        for name, value in verb.arguments(Zonotope).items():
            if isinstance(value, Each):
                bad = np.array(value.array)
                bad.flat[0] = nan
                filled.append(Wrong(verb.name, name, bad, ("NaN",)))
                if name not in verb.infinite:
                    bad = np.array(value.array)
                    bad.flat[-1] = inf
                    filled.append(Wrong(verb.name, name, bad, ("infinity",)))
    return shapes + filled


WRONG = _wrong()


@pytest.mark.parametrize("wrong", WRONG, ids=[str(wrong) for wrong in WRONG])
@both
def test_bad_input_is_named(kind: type[AnySet], wrong: Wrong) -> None:
    verb = next(v for v in VERBS if v.name == wrong.verb)
    value = wrong.value
    if isinstance(value, Zonotope) and kind is ConstrainedZonotope:
        value = ConstrainedZonotope.from_zonotope(value)
    arguments = {**at(verb.arguments(kind), ()), wrong.argument: value}
    with pytest.raises(SetError) as raised:
        verb.call(kind if verb.constructor else sets(kind), arguments)
    message = str(raised.value)
    assert re.search(rf"\b{re.escape(wrong.argument)}\b", message), message
    for part in wrong.says:
        assert part in message, message


@pytest.mark.parametrize("name", ["area", "area_bracket", "polygon"])
@both
def test_planar_questions_ask_for_planar_sets(kind: type[AnySet], name: str) -> None:
    with pytest.raises(SetError, match=rf"{name} needs a planar set, this one has dimension 3: project it first"):
        getattr(sets(kind, 0, 3), name)()


FIELDS_WRONG: tuple[tuple[dict[str, Any], tuple[str, ...]], ...] = (
    ({"center": np.ones(3)}, ("generators", "(2, 3, 2, 6)", "(..., 3, …)")),
    ({"center": np.ones(())}, ("center", "()", "(..., …)")),
    ({"center": np.full((*BATCH, N), np.nan)}, ("center", "NaN")),
    ({"center": np.full((*BATCH, N), np.inf)}, ("center", "infinity")),
    ({"center": np.zeros((*BATCH, 0)), "generators": np.zeros((*BATCH, 0, G))}, ("center", "(2, 3, 0)", "dimension")),
    ({"center": np.zeros((7, N))}, ("(7,)", "(2, 3)")),
    ({"generators": np.full((N, G), -np.inf)}, ("generators", "infinity")),
    ({"generators": "many"}, ("generators", "numbers")),
    ({"direction": "exact"}, ("direction", "exact")),
)


@pytest.mark.parametrize(("wrong", "says"), FIELDS_WRONG, ids=[" ".join(says) for _, says in FIELDS_WRONG])
@both
def test_bad_fields_are_named(kind: type[AnySet], wrong: dict[str, Any], says: tuple[str, ...]) -> None:
    with pytest.raises(SetError) as raised:
        replace(sets(kind), **wrong)
    assert all(part in str(raised.value) for part in says), str(raised.value)


CONSTRAINTS_WRONG: tuple[tuple[dict[str, Any], tuple[str, ...]], ...] = (
    ({"constraint_matrix": np.ones((ROWS, G + 1))}, ("constraint_matrix", "(2, 7)", "(..., …, 6)")),
    ({"constraint_matrix": np.full((ROWS, G), np.nan)}, ("constraint_matrix", "NaN")),
    ({"constraint_offset": np.ones(ROWS + 1)}, ("constraint_offset", "(3,)", "(..., 2)")),
    ({"constraint_offset": np.full(ROWS, np.inf)}, ("constraint_offset", "infinity")),
    ({"constraint_matrix": np.ones((7, 1, ROWS, G))}, ("(7, 1)", "(2, 3)")),
)


@pytest.mark.parametrize(("wrong", "says"), CONSTRAINTS_WRONG, ids=[" ".join(says) for _, says in CONSTRAINTS_WRONG])
def test_bad_constraints_are_named(wrong: dict[str, Any], says: tuple[str, ...]) -> None:
    with pytest.raises(SetError) as raised:
        replace(sets(ConstrainedZonotope), **wrong)
    assert all(part in str(raised.value) for part in says), str(raised.value)
