"""Both classes offer the same verbs, alike on every batch shape, with tags that compose and errors that name.

Containment is tested where the operations are; here it is only that verbs, batches, tags and errors are those promised.
"""

import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shapely import Polygon

from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, Direction, SetError, Zonotope
from tests.reach_server.ugly import Raw, assert_holds, directions, extreme, of

AnySet = Zonotope | ConstrainedZonotope
EXACT, OUTER, INNER = Direction.EXACT, Direction.OUTER, Direction.INNER

KINDS: tuple[type[AnySet], ...] = (Zonotope, ConstrainedZonotope)
PAGE = Path(__file__).parents[3] / "docs" / "concepts" / "sets.md"
BATCH = (2, 3)
N, G, ROWS = 2, 6, 2


@dataclass(frozen=True, eq=False)
class Each:
    """An argument with one entry per set: the batch axes come first."""

    array: FloatArray


def draw(seed: int, *tail: int) -> Each:
    return Each(np.random.default_rng(seed).normal(size=(*BATCH, *tail)))


def sets(kind: type[AnySet], seed: int = 0, n: int = N) -> AnySet:
    """A batch of inhabited sets; those of odd seeds overlap those of even ones."""
    rng = np.random.default_rng([seed, n])
    center, generators = rng.normal(size=(*BATCH, n)) / 4, rng.normal(size=(*BATCH, n, G))
    if kind is Zonotope:
        return Zonotope(center, generators)
    matrix = rng.normal(size=(*BATCH, ROWS, G))
    offset = (matrix @ rng.uniform(-0.5, 0.5, (*BATCH, G, 1)))[..., 0]
    return ConstrainedZonotope(center, generators, matrix, offset)


@dataclass(frozen=True, eq=False)
class Verb:
    """``name(**arguments)``, what it returns, and how that relates to the truth for either class.

    Arguments named by ``infinite`` may be infinite.
    """

    name: str
    arguments: Callable[[type[AnySet]], dict[str, Any]] = lambda kind: {}
    zonotope: Direction | None = None
    constrained: Direction | None = None
    infinite: tuple[str, ...] = ()
    constructor: bool = False

    def __str__(self) -> str:
        return f"{self.name}({', '.join(self.arguments(Zonotope))})"

    def step(self, kind: type[AnySet]) -> Direction | None:
        return self.zonotope if kind is Zonotope else self.constrained

    def call(self, subject: AnySet | type[AnySet], arguments: dict[str, Any]) -> Any:
        return getattr(subject, self.name)(**arguments)


def _linearised(kind: type[AnySet]) -> dict[str, Any]:
    low = Each(-np.abs(draw(15).array) / 10)
    return {"J": draw(13, N), "h0": draw(14), "remainder": (low, Each(low.array + 0.3)), "r": Each(np.full(BATCH, 0.7))}


MAKING = (
    Verb("linear_map", lambda kind: {"matrix": draw(1, 3, N)}, EXACT, EXACT),
    Verb("affine_map", lambda kind: {"matrix": draw(1, 3, N), "offset": draw(2, 3)}, EXACT, EXACT),
    Verb("scale", lambda kind: {"factor": draw(3)}, EXACT, EXACT),
    Verb("translate", lambda kind: {"offset": draw(4, N)}, EXACT, EXACT),
    Verb("project", lambda kind: {"axes": (1,)}, EXACT, EXACT),
    Verb("minkowski_sum", lambda kind: {"other": sets(kind, 1)}, EXACT, EXACT),
    Verb("cartesian_product", lambda kind: {"other": sets(kind, 1, 3)}, EXACT, EXACT),
    Verb("convex_hull", lambda kind: {"other": sets(kind, 1)}, OUTER, EXACT),
    Verb(
        "intersect_strip",
        lambda kind: {"H": draw(5, N), "q": Each(draw(6).array / 4), "r": Each(np.abs(draw(7).array) / 2)},
        OUTER, EXACT, ("r",),
    ),
    Verb("intersect_halfspace", lambda kind: {"H": draw(8, N), "q": Each(draw(9).array / 4)}, OUTER, EXACT, ("q",)),
    Verb(
        "intersect_tangents",
        lambda kind: {"H": draw(10, 4, N), "q": Each(np.abs(draw(11, 4).array) / 2)}, OUTER, EXACT, ("q",),
    ),
    Verb("intersect_linearised", _linearised, OUTER, OUTER, ("r", "remainder")),
    Verb("intersection", lambda kind: {"other": sets(kind, 1)}, OUTER, EXACT),
    Verb("intersection", lambda kind: {"other": sets(kind, 1, 3), "matrix": draw(16, 3, N)}, OUTER, EXACT),
    Verb("reduce_order", lambda kind: {"order": 2}, OUTER, OUTER),
    Verb("simplify", lambda kind: {}, EXACT, EXACT),
    Verb("enclosing_zonotope", lambda kind: {}, EXACT, OUTER),
)  # fmt: skip


def _ends(kind: type[AnySet]) -> dict[str, Any]:
    return {"lower": Each(draw(20, N).array - 5), "upper": Each(draw(21, N).array + 5)}


CONSTRUCTION = (
    Verb("box", _ends, EXACT, EXACT, constructor=True),
    Verb("point", lambda kind: {"x": draw(22, N)}, EXACT, EXACT, constructor=True),
    Verb("from_interval", lambda kind: {"interval": tuple(_ends(kind).values())}, EXACT, EXACT, constructor=True),
)

ASKING = (
    Verb("support", lambda kind: {"d": draw(30, 5, N)}),
    Verb("interval_hull"),
    Verb("is_empty"),
    Verb("contains_point", lambda kind: {"x": Each(draw(31, N).array / 2)}),
    Verb("factors_of", lambda kind: {"x": Each(draw(31, N).array / 2)}),
    Verb("contains_set", lambda kind: {"other": sets(kind, 1)}),
    Verb("intersects", lambda kind: {"other": sets(kind, 1)}),
    Verb("volume"),
    Verb("area"),
    Verb("volume_bracket"),
    Verb("area_bracket"),
    Verb("polygon"),
)
SAMPLING = (Verb("sample", lambda kind: {"rng": np.random.default_rng(3), "count": 5}),)
VERBS = (*CONSTRUCTION, *MAKING, *ASKING, *SAMPLING)
#: Verbs of one class, which act on what the other does not have, or ask what the other need not be asked.
OWN: dict[type[AnySet], tuple[Verb, ...]] = {
    Zonotope: (
        Verb("misses_strip", lambda kind: {"H": draw(5, N), "q": draw(6), "r": Each(np.abs(draw(7).array) / 9)}),
    ),
    ConstrainedZonotope: (
        Verb("reduce_constraints", lambda kind: {"count": 1}, None, OUTER),
        Verb("keep_newest_constraints", lambda kind: {"count": 1}, None, OUTER),
        Verb("rescale", lambda kind: {}, None, EXACT),
        Verb("support_certificate", lambda kind: {"d": draw(30, 5, N)}),
        Verb("emptiness_certificate"),
    ),
}
OWN_MAKING = {kind: tuple(verb for verb in own if verb.step(kind) is not None) for kind, own in OWN.items()}
FIELDS = {"center", "generators", "direction", "batch", "dimension"}
#: What one class has beside the verbs.
ALONE: dict[type[AnySet], set[str]] = {
    Zonotope: {"misses_strip"},
    ConstrainedZonotope: {"constraint_matrix", "constraint_offset", "from_zonotope"}
    | {verb.name for verb in OWN[ConstrainedZonotope]},
}
#: Parameters after the common ones that only the zonotope's enclosures need; all have defaults.
CHOICES = {"method"}

both = pytest.mark.parametrize("kind", KINDS, ids=["zonotope", "constrained"])


def verbs(*families: tuple[Verb, ...]) -> pytest.MarkDecorator:
    chosen = [verb for family in families for verb in family]
    return pytest.mark.parametrize("verb", chosen, ids=[str(verb) for verb in chosen])


def pairs(own: dict[type[AnySet], tuple[Verb, ...]], *families: tuple[Verb, ...]) -> pytest.MarkDecorator:
    """Both classes with every common verb, and each with its own."""
    chosen = [(kind, verb) for kind in KINDS for family in (*families, own[kind]) for verb in family]
    ids = [f"{kind.__name__}-{verb}" for kind, verb in chosen]
    return pytest.mark.parametrize(("kind", "verb"), chosen, ids=ids)


def at(value: Any, place: Any) -> Any:
    """What belongs to some places of the batch."""
    if isinstance(value, Each):
        return value.array[place]
    if isinstance(value, Zonotope | ConstrainedZonotope):
        arrays = {name: getattr(value, name)[place] for name in ("center", "generators")}
        if isinstance(value, ConstrainedZonotope):
            arrays |= {name: getattr(value, name)[place] for name in ("constraint_matrix", "constraint_offset")}
        return replace(value, **arrays)
    if isinstance(value, dict):
        return {name: at(entry, place) for name, entry in value.items()}
    if isinstance(value, tuple):
        return tuple(at(entry, place) for entry in value)
    return value


def arrays(case: Raw) -> tuple[FloatArray, ...]:
    return case.c, case.G, case.A, case.b


def one_of(result: AnySet, place: tuple[int, ...]) -> AnySet:
    """One set of a result, whose arrays need not all have the batch axes."""
    own = {"center": 1, "generators": 2, "constraint_matrix": 2, "constraint_offset": 1}
    found = {}
    for name, axes in own.items():
        array = getattr(result, name, None)
        if array is not None:
            found[name] = np.broadcast_to(array, (*result.batch, *array.shape[array.ndim - axes :]))[place]
    return replace(result, **found)


def assert_equal(result: Any, place: tuple[int, ...], single: Any) -> None:
    """The entry of a batch's result is the result for the set alone."""
    if isinstance(single, Zonotope | ConstrainedZonotope):
        assert type(result) is type(single)
        assert result.direction is single.direction
        assert single.batch == ()
        ours, alone = of(one_of(result, place)), of(single)
        if all(
            a.shape == b.shape and np.allclose(a, b, 1e-9, 1e-12)
            for a, b in zip(arrays(ours), arrays(alone), strict=True)
        ):
            return
        # A batch may keep a column or row that this set does not need: then the sets must be the same.
        for d in directions(single.dimension, 3):
            found, wanted = extreme(ours, d), extreme(alone, d)
            assert (found is None) == (wanted is None)
            if found is not None and wanted is not None:
                assert found[0] == pytest.approx(wanted[0], rel=1e-6, abs=1e-6 * alone.size)
        return
    if is_dataclass(single):
        names = [field.name for field in fields(single)]
        result, single = (tuple(getattr(entry, name) for name in names) for entry in (result, single))
    if isinstance(single, tuple):
        assert len(result) == len(single)
        for whole, part in zip(result, single, strict=True):
            assert_equal(whole, place, part)
        return
    assert np.asarray(result).dtype == np.asarray(single).dtype
    np.testing.assert_allclose(np.asarray(result)[place], single, rtol=1e-6, atol=1e-6)


def parts_of(result: Any) -> list[Any]:
    """The arrays of an answer with all their batch axes; of a set, its batch alone."""
    if isinstance(result, Zonotope | ConstrainedZonotope):
        return [np.zeros(result.batch)]
    if is_dataclass(result):
        return [getattr(result, field.name) for field in fields(result)]
    return list(result) if isinstance(result, tuple) else [result]


def corners_of(polygon: FloatArray) -> Polygon:
    return Polygon(polygon[np.isfinite(polygon).all(axis=-1)]).buffer(0)


def parameters(kind: type[AnySet], name: str) -> dict[str, tuple[Any, Any]]:
    found = inspect.signature(getattr(kind, name)).parameters
    return {p.name: (p.kind, p.default) for p in found.values() if p.name not in CHOICES}


def public(kind: type[AnySet]) -> set[str]:
    return {name for name in (*dir(kind), *kind.__dataclass_fields__) if not name.startswith("_")}


def test_both_classes_offer_the_same_verbs() -> None:
    wanted = {verb.name for verb in VERBS}
    for kind in KINDS:
        assert wanted <= public(kind), f"{kind.__name__} lacks {sorted(wanted - public(kind))}"
        others = public(kind) - wanted - FIELDS - ALONE[kind]
        assert not others, f"{kind.__name__} alone has {sorted(others)}"


@verbs(VERBS)
def test_the_signatures_are_the_same(verb: Verb) -> None:
    assert parameters(Zonotope, verb.name) == parameters(ConstrainedZonotope, verb.name)
    for kind in KINDS:
        for p in inspect.signature(getattr(kind, verb.name)).parameters.values():
            assert p.name not in CHOICES or p.default is not p.empty


@pairs(OWN, VERBS)
def test_docstrings_say_what_comes_back(kind: type[AnySet], verb: Verb) -> None:
    text = getattr(kind, verb.name).__doc__
    assert text, f"{kind.__name__}.{verb.name} has no docstring"
    step = verb.step(kind)
    if step is not None:
        assert step.value in text, f"{kind.__name__}.{verb.name} does not say that its result is {step.value}"


@pairs(OWN, CONSTRUCTION, MAKING, tuple(verb for verb in ASKING if verb.name != "polygon"))
def test_every_batch_shape_gives_the_same(kind: type[AnySet], verb: Verb) -> None:
    subject: Any = kind if verb.constructor else sets(kind)
    arguments = verb.arguments(kind)
    whole = verb.call(subject, at(arguments, ()))
    singles = {place: verb.call(at(subject, place), at(arguments, place)) for place in np.ndindex(*BATCH)}
    for place, single in singles.items():
        assert_equal(whole, place, single)
    row = verb.call(at(subject, 1), at(arguments, 1))
    for k in range(BATCH[1]):
        assert_equal(row, (k,), singles[1, k])


@both
def test_outlines_are_the_same_on_every_batch_shape(kind: type[AnySet]) -> None:
    batch = sets(kind)
    whole, row = batch.polygon(), at(batch, 1).polygon()
    for place in np.ndindex(*BATCH):
        single = corners_of(at(batch, place).polygon())
        assert corners_of(whole[place]).symmetric_difference(single).area <= 1e-9 * single.area
        if place[0] == 1:
            assert corners_of(row[place[1]]).symmetric_difference(single).area <= 1e-9 * single.area


@pytest.mark.parametrize("how", ["inside", "boundary", "factors"])
@both
def test_samples_are_members_on_every_batch_shape(kind: type[AnySet], how: Any) -> None:
    batch = sets(kind)
    for place, shape in ((np.s_[:, :], BATCH), (1, BATCH[1:]), ((1, 2), ())):
        chosen = at(batch, place)
        drawn = chosen.sample(np.random.default_rng(8), 4, how)
        assert drawn.shape == (*shape, 4, N)
        for index in np.ndindex(*shape):
            assert_holds(of(at(chosen, index)), drawn[index])


@pairs(OWN, CONSTRUCTION, MAKING, ASKING)
@pytest.mark.parametrize("place", [np.s_[:0], np.s_[:, :0], (0, np.s_[:0])], ids=["(0, 3)", "(2, 0)", "(0,)"])
def test_empty_batches_work(kind: type[AnySet], verb: Verb, place: Any) -> None:
    subject: Any = kind if verb.constructor else at(sets(kind), place)
    shape = np.zeros(BATCH)[place].shape
    result = verb.call(subject, at(verb.arguments(kind), place))
    for part in parts_of(result):
        assert part.shape[: len(shape)] == shape


@both
def test_an_empty_batch_can_be_sampled(kind: type[AnySet]) -> None:
    assert at(sets(kind), np.s_[:0]).sample(np.random.default_rng(0), 4).shape == (0, 3, 4, N)


@pairs(OWN_MAKING, CONSTRUCTION, MAKING)
def test_the_tag_says_what_the_operation_does(kind: type[AnySet], verb: Verb) -> None:
    subject: Any = kind if verb.constructor else sets(kind)
    assert verb.call(subject, at(verb.arguments(kind), ())).direction is verb.step(kind)


@pairs(OWN_MAKING, MAKING)
def test_tags_compose(kind: type[AnySet], verb: Verb) -> None:
    step, arguments = verb.step(kind), at(verb.arguments(kind), ())
    assert verb.call(replace(sets(kind), direction=OUTER), arguments).direction is OUTER
    inner = replace(sets(kind), direction=INNER)
    if step is EXACT:
        assert verb.call(inner, arguments).direction is INNER
    else:
        with pytest.raises(SetError, match=r"outer.*inner|inner.*outer"):
            verb.call(inner, arguments)
    if "other" in arguments:
        outer = {**arguments, "other": replace(arguments["other"], direction=OUTER)}
        assert verb.call(sets(kind), outer).direction is OUTER
        with pytest.raises(SetError, match=r"outer.*inner|inner.*outer"):
            verb.call(inner, outer)


def test_a_zonotope_is_a_constrained_one_without_rows() -> None:
    subject, plain = sets(ConstrainedZonotope), sets(Zonotope, 1)
    assert isinstance(plain, Zonotope)
    for name in TWO:
        found, wanted = (getattr(subject, name)(other) for other in (plain, ConstrainedZonotope.from_zonotope(plain)))
        for place in np.ndindex(*BATCH):
            if isinstance(wanted, ConstrainedZonotope):
                assert_equal(found, place, one_of(wanted, place))
            else:
                assert found[place] == wanted[place]
    # The other way round a zonotope cannot hold the result, but can be asked.
    assert plain.contains_set(subject).shape == BATCH
    for name in TWO:
        if name != "contains_set":
            with pytest.raises(SetError, match="other is a ConstrainedZonotope"):
                getattr(plain, name)(subject)


@verbs(MAKING, ASKING)
@both
def test_shared_arguments_are_taken_by_every_set(kind: type[AnySet], verb: Verb) -> None:
    arguments = at(verb.arguments(kind), (0, 1))
    whole = verb.call(sets(kind), arguments)
    for place in ((0, 0), (1, 2)):
        single = verb.call(at(sets(kind), place), arguments)
        if verb.name == "polygon":
            assert corners_of(whole[place]).equals_exact(corners_of(single), 1e-9)
        else:
            assert_equal(whole, place, single)


@dataclass(frozen=True, eq=False)
class Wrong:
    """An argument of a verb, a bad value, and what the message must say."""

    verb: str
    argument: str
    value: Any
    says: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.verb}, {self.argument}: {self.says[-1]}"


#: Verbs of two sets.
TWO = ("minkowski_sum", "cartesian_product", "convex_hull", "intersection", "contains_set", "intersects")


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


def bare(kind: Callable[..., AnySet], *shapes: tuple[int, ...], fill: float = 0.0) -> AnySet:
    """A set of arrays of these shapes: one number everywhere but in the center."""
    rng = np.random.default_rng(11)
    center, *rest = (rng.normal(size=shape) if k == 0 else np.full(shape, fill) for k, shape in enumerate(shapes))
    return kind(center, *rest)


UGLY: dict[str, AnySet] = {
    "no generators": bare(Zonotope, (2, 3, 2), (2, 0)),
    "zero generators": bare(Zonotope, (2, 3, 2), (2, 4)),
    "shared generators": bare(Zonotope, (2, 3, 2), (2, 4), fill=0.5),
    "crossed batch axes": bare(Zonotope, (1, 3, 2), (2, 1, 2, 4), fill=0.5),
    "no generators, no rows": bare(ConstrainedZonotope, (2, 3, 2), (2, 0), (0, 0), (0,)),
    "no generators, a row": bare(ConstrainedZonotope, (2, 3, 2), (2, 0), (1, 0), (1,)),
    "no generators, a row that cannot hold": bare(ConstrainedZonotope, (2, 3, 2), (2, 0), (1, 0), (1,), fill=1.0),
    "zero generators, zero row": bare(ConstrainedZonotope, (2, 3, 2), (2, 4), (1, 4), (1,)),
    "no rows": bare(ConstrainedZonotope, (2, 3, 2), (2, 4), (0, 4), (0,), fill=0.5),
    "batch in the offset": bare(ConstrainedZonotope, (2,), (2, 4), (1, 4), (2, 3, 1), fill=0.5),
    "batch in the matrix": bare(ConstrainedZonotope, (2,), (2, 4), (2, 3, 1, 4), (1,), fill=0.5),
    "crossed batch axes, rows": bare(ConstrainedZonotope, (1, 3, 2), (2, 1, 2, 4), (3, 1, 4), (1,), fill=0.5),
}


@pytest.mark.parametrize("name", UGLY)
def test_degenerate_arrays_keep_the_batch(name: str) -> None:
    subject = UGLY[name]
    assert subject.batch == BATCH
    for verb in (*MAKING, *ASKING, *SAMPLING, *OWN[type(subject)]):
        result = verb.call(subject, at(verb.arguments(type(subject)), ()))
        for part in parts_of(result):
            assert part.shape[:2] == BATCH, verb


#: An enclosure of an empty set may hold points; the hull of it and another set is that set.
MAY_FILL = {"convex_hull", "reduce_order", "reduce_constraints", "keep_newest_constraints"}


@verbs(MAKING, ASKING, OWN[ConstrainedZonotope])
def test_an_empty_set_is_a_value(verb: Verb) -> None:
    empty = ConstrainedZonotope(np.zeros((*BATCH, N)), np.eye(N), np.ones((1, N)), np.array([3.0]))
    assert empty.is_empty().all()
    result = verb.call(empty, at(verb.arguments(ConstrainedZonotope), ()))
    if isinstance(result, ConstrainedZonotope) and verb.name not in MAY_FILL:
        assert result.is_empty().all()


def test_the_page_lists_every_verb_with_its_direction() -> None:
    text = PAGE.read_text(encoding="utf-8")
    rows = {
        name: (zonotope, constrained)
        for names, zonotope, constrained in re.findall(r"^\| (`[^|]+`) \| ([^|]+?) \| ([^|]+?) \|", text, re.M)
        for name in re.findall(r"`(\w+)\(", names)
    }
    for verb in (*CONSTRUCTION, *MAKING):
        for kind, said in zip(KINDS, rows[verb.name], strict=True):
            step = verb.step(kind)
            assert step is not None
            assert said.split()[0].rstrip(",;") == step.value, (verb.name, kind.__name__)
    assert {verb.name for verb in VERBS} <= rows.keys()
    assert rows.keys() <= {verb.name for verb in VERBS} | ALONE[Zonotope] | ALONE[ConstrainedZonotope]
