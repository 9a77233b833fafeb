"""Both classes offer the same verbs, alike on every batch shape, with tags that compose and errors that name.

Containment is tested where the operations are; here it is only that verbs, batches, tags and errors are those promised.
"""

import inspect
import re
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shapely import Polygon

from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, SetError, Zonotope
from tests.reach_server.sets.verbs import (
    ASKING,
    BATCH,
    CONSTRUCTION,
    EXACT,
    INNER,
    KINDS,
    MAKING,
    OUTER,
    SAMPLING,
    TWO,
    VERBS,
    AnySet,
    Each,
    N,
    Verb,
    at,
    both,
    draw,
    sets,
)
from tests.reach_server.ugly import Raw, assert_holds, directions, extreme, of

PAGE = Path(__file__).parents[3] / "docs" / "concepts" / "sets.md"
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


def verbs(*families: tuple[Verb, ...]) -> pytest.MarkDecorator:
    chosen = [verb for family in families for verb in family]
    return pytest.mark.parametrize("verb", chosen, ids=[str(verb) for verb in chosen])


def pairs(own: dict[type[AnySet], tuple[Verb, ...]], *families: tuple[Verb, ...]) -> pytest.MarkDecorator:
    """Both classes with every common verb, and each with its own."""
    chosen = [(kind, verb) for kind in KINDS for family in (*families, own[kind]) for verb in family]
    ids = [f"{kind.__name__}-{verb}" for kind, verb in chosen]
    return pytest.mark.parametrize(("kind", "verb"), chosen, ids=ids)


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
