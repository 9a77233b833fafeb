"""Formulas: what text means, what it is printed as, what is refused and where."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from side_info import Always, And, Comparison, Declarations, Formula, Region, ScenarioError
from side_info.expression import (
    Call,
    Expression,
    Name,
    Negation,
    Number,
    Power,
    Product,
    Reciprocal,
    Sum,
    number_text,
)
from side_info.formula import window_ns
from side_info.parser import MAX_LENGTH
from tests.side_info.corpus import FORMULAS

DECLARED = Declarations(("x1", "x2", "x3"), ("P", "O"), {"T": 25.0, "r": -1.5})


def parse(text: str) -> Formula:
    return Formula.parse(text, DECLARED, "test")


@pytest.mark.parametrize("word", ["always", "globally", "alw", "G", "always_", "G_", "G "])
@pytest.mark.parametrize(
    "window", ["[0:25]", "[0,25]", "[ 0 : 25 s ]", "[0 ms:25000ms]", "[0:T]", "[0 min:25.0]", "[.0:2.5e1]"]
)
def test_window_spellings_are_one_formula(word: str, window: str) -> None:
    assert parse(f"{word}{window}(P)") == Always(0.0, 25.0, Region("P"))


@pytest.mark.parametrize("sign", ["and", "&", "&&"])
def test_and_spellings_are_one_formula(sign: str) -> None:
    assert parse(f"P {sign} O{sign} x1>=0".replace("Oand", "O and")) == And(
        (Region("P"), Region("O"), Comparison((Name("x1"), Number(0.0)), (">=",)))
    )


def test_always_binds_tighter_than_and_and_looser_than_comparison() -> None:
    assert parse("G[0:1] x1 >= 0 and P") == And(
        (Always(0.0, 1.0, Comparison((Name("x1"), Number(0.0)), (">=",))), Region("P"))
    )


def test_parentheses_around_numbers_and_formulas() -> None:
    assert parse("always[0:1] (x1) + 2 >= 0") == parse("always[0:1]((x1 + 2) >= (0))")


def test_membership_is_the_region() -> None:
    assert parse("in(P)") == Region("P")


def test_parameters_are_their_values() -> None:
    assert parse("T*x1 <= r") == parse("25*x1 <= -1.5")


def test_milliseconds_are_decimal() -> None:
    # 9 * 1e-3 is 0.009000000000000001
    assert parse("always[9 ms:1.1 min](P)") == Always(0.009, 66.0, Region("P"))


def test_precedence_of_arithmetic() -> None:
    x, y = Name("x1"), Name("x2")
    one, two = Number(1.0), Number(2.0)
    cases: dict[str, Expression] = {
        "1 - x1 - x2": Sum((one, Negation(x), Negation(y))),
        "-x1^2": Negation(Power(x, two)),
        "x1^-2^x2": Power(x, Negation(Power(two, y))),
        "x1 ** 2": Power(x, two),
        "2*x1/x2": Product((two, x, Reciprocal(y))),
        "1 + -x1*2": Sum((one, Product((Negation(x), two)))),
        "+x1": x,
        "norm(x1 - 1, +x2)": Call("norm", (Sum((x, Negation(one))), y)),
    }
    for text, expression in cases.items():
        assert parse(f"{text} <= 0") == Comparison((expression, Number(0.0)), ("<=",)), text


@pytest.mark.parametrize(("text", "line", "column", "words"), FORMULAS)
def test_refusals_name_line_column_and_reason(text: str, line: int, column: int, words: str) -> None:
    with pytest.raises(ScenarioError) as refused:
        parse(text)
    first, shown, caret = str(refused.value).split("\n")
    assert first.startswith(f"test:{line}:{column}: "), first
    assert words in first
    assert caret.index("^") <= len(shown)


def test_the_caret_stands_below_the_culprit() -> None:
    with pytest.raises(ScenarioError) as refused:
        parse("always[0:1](P) and always[0:1](Q)")
    _, shown, caret = str(refused.value).split("\n")
    assert shown[caret.index("^")] == "Q"


def test_a_formula_that_is_too_long_is_refused() -> None:
    with pytest.raises(ScenarioError, match=f"at most {MAX_LENGTH}"):
        parse("P and " * MAX_LENGTH + "P")


def test_many_parentheses_are_no_depth() -> None:
    assert parse("(" * 9000 + "P" + ")" * 9000) == Region("P")


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        (0.0, 25.0, (0, 25 * 10**9)),
        (0.29, 0.57, (290_000_000, 570_000_000)),
        (0.1 + 0.2, 0.4, (300_000_000, 400_000_000)),
        (9 * 1e-3, 1.0, (9_000_000, 10**9)),
        (1.5e-9, 2.5e-9, (2, 2)),
        (123456789.123456789, 1e9, (123456789123456790, 10**18)),
    ],
)
def test_windows_in_nanoseconds(start: float, end: float, expected: tuple[int, int]) -> None:
    assert window_ns(start, end) == expected


numbers = st.floats(0, 1e300, allow_subnormal=False).map(lambda value: Number(value + 0.0))


def _larger(inner: st.SearchStrategy[Expression]) -> st.SearchStrategy[Expression]:
    several = st.lists(inner, min_size=2, max_size=3).map(tuple)
    factors = st.tuples(inner, st.lists(inner | inner.map(Reciprocal), min_size=1, max_size=3))
    return st.one_of(
        several.map(Sum),
        factors.map(lambda pair: Product((pair[0], *pair[1]))),
        inner.map(Negation),
        st.tuples(inner, inner).map(lambda pair: Power(*pair)),
        inner.map(lambda argument: Call("abs", (argument,))),
        st.tuples(st.sampled_from(["norm", "sumsqr"]), several).map(lambda pair: Call(*pair)),
    )


small: st.SearchStrategy[Expression] = numbers | st.sampled_from(["x1", "x2"]).map(Name)
expressions = st.recursive(small, _larger, max_leaves=8)


@st.composite
def comparisons(draw: st.DrawFn) -> Formula:
    operators = draw(st.sampled_from([("<",), (">=",), ("<=", "<"), (">", ">="), ("<=", "<=", "<=")]))
    count = len(operators) + 1
    return Comparison(tuple(draw(st.lists(expressions, min_size=count, max_size=count))), operators)


def conjunctions(inner: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    return st.lists(inner, min_size=2, max_size=3).map(lambda operands: And(tuple(operands)))


timeless = st.recursive(comparisons() | st.sampled_from(["P", "O"]).map(Region), conjunctions, max_leaves=4)
bounds = st.tuples(st.floats(0, 1e6), st.floats(0, 1e3)).filter(lambda b: window_ns(b[0], b[0] + b[1])[0] > 0)
windows = st.tuples(bounds, timeless).map(lambda w: Always(w[0][0], w[0][0] + w[0][1] + 1e-6, w[1]))
formulas = st.recursive(windows | timeless, conjunctions, max_leaves=4)


@given(formulas)
def test_what_is_printed_reads_back(formula: Formula) -> None:
    assert parse(str(formula)) == formula


@given(st.floats(0, allow_infinity=False))
def test_numbers_are_printed_exactly(value: float) -> None:
    assert float(number_text(value)) == value


WORDS = "always G_ [0:1] [ 0 : 1 ( ) P x1 >= < == + - * / ^ and or not F[0:1] U -> abs( norm( , 2.5 1e9 T ms in("
words = st.sampled_from([*WORDS.split(), "\n", " ", "1 s]"])


@given(st.text() | st.lists(words).map("".join) | st.lists(words).map(" ".join))
def test_any_text_is_read_or_refused(text: str) -> None:
    with suppress(ScenarioError):
        formula = parse(text)
        assert parse(str(formula)) == formula
