"""Formulas: what text means, what it is printed as, what is refused and where."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from side_info import (
    Always,
    And,
    Comparison,
    Declarations,
    Eventually,
    Formula,
    Implies,
    Not,
    Or,
    Region,
    ScenarioError,
    Until,
)
from side_info.stl.expression import (
    Call,
    Expression,
    Last,
    Name,
    Negation,
    Number,
    Power,
    Product,
    Reciprocal,
    Steps,
    Sum,
    Time,
    number_text,
)
from side_info.stl.parser import MAX_LENGTH
from side_info.stl.windows import window_ns
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


P, Q, X = Region("P"), Region("O"), Comparison((Name("x1"), Number(0.0)), (">=",))


@pytest.mark.parametrize("word", ["eventually", "finally", "ev", "F", "eventually_", "F_", "F "])
def test_eventually_spellings_are_one_formula(word: str) -> None:
    assert parse(f"{word}[0:25 s](P)") == Eventually(0.0, 25.0, P)


@pytest.mark.parametrize("word", ["until", "U", "until_", "U_", "U "])
def test_until_spellings_are_one_formula(word: str) -> None:
    assert parse(f"P {word}[0,25] O") == Until(0.0, 25.0, P, Q)


@pytest.mark.parametrize("sign", ["or", "|", "||", " or\n"])
def test_or_spellings_are_one_formula(sign: str) -> None:
    assert parse(f"P {sign} O") == Or((P, Q))


@pytest.mark.parametrize("sign", ["not ", "!", "~", "! "])
def test_not_spellings_are_one_formula(sign: str) -> None:
    assert parse(f"{sign}P") == Not(P)


@pytest.mark.parametrize("sign", ["->", "=>", "implies"])
def test_implies_spellings_are_one_formula(sign: str) -> None:
    assert parse(f"P {sign} O") == Implies(P, Q)


def test_precedence_of_logic() -> None:
    cases: dict[str, Formula] = {
        "P or O and x1 >= 0": Or((P, And((Q, X)))),
        "not P and O": And((Not(P), Q)),
        "not x1 >= 0 and O": And((Not(X), Q)),
        "not not P": Not(Not(P)),
        "P -> O -> x1 >= 0": Implies(P, Implies(Q, X)),
        "(P -> O) -> x1 >= 0": Implies(Implies(P, Q), X),
        "P or O -> P and O": Implies(Or((P, Q)), And((P, Q))),
        "F[0:1] P and O": And((Eventually(0.0, 1.0, P), Q)),
        "G[0:1] not F[0:2] P": Always(0.0, 1.0, Not(Eventually(0.0, 2.0, P))),
        "P and O U[0:1] x1 >= 0 or P": Or((And((P, Until(0.0, 1.0, Q, X))), P)),
        "not P U[0:1] G[2:3] O": Until(0.0, 1.0, Not(P), Always(2.0, 3.0, Q)),
        "P U[0:1] (O U[0:1] P)": Until(0.0, 1.0, P, Until(0.0, 1.0, Q, P)),
    }
    for text, formula in cases.items():
        assert parse(text) == formula, text


def test_operators_of_python_build_the_same() -> None:
    assert P.always(0, 25) & Q.eventually(0, 25) & X == parse("always[0:25](P) and eventually[0:25](O) and x1 >= 0")
    assert (~P | Q | X) >> P.until(Q & X, 0, 1.5) == parse("not P or O or x1 >= 0 -> P until[0:1.5] (O and x1 >= 0)")
    for make in (P.always, P.eventually):
        with pytest.raises(ScenarioError, match="reversed"):
            make(2, 1)
    with pytest.raises(ScenarioError, match="a bound of -1 s"):
        P.until(Q, -1, 1)


def test_time_steps_and_the_last_state() -> None:
    speed = Product((Number(2.0), Time()))
    assert parse("x1 - last(x1) <= 2*t") == Comparison((Sum((Name("x1"), Negation(Last("x1")))), speed), ("<=",))
    assert parse("t - last(t) == 0.05*k") == Comparison(
        (Sum((Time(), Negation(Last("t")))), Product((Number(0.05), Steps()))), ("==",)
    )


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


numbers = st.floats(0, 1e300, allow_subnormal=False).map(lambda value: Number(value + 0.0))


def _larger(inner: st.SearchStrategy[Expression]) -> st.SearchStrategy[Expression]:
    several = st.lists(inner, min_size=2, max_size=3).map(tuple)
    factors = st.tuples(inner, st.lists(inner | inner.map(Reciprocal), min_size=1, max_size=3))
    return st.one_of(
        several.map(Sum),
        factors.map(lambda pair: Product((pair[0], *pair[1]))),
        inner.map(Negation),
        st.tuples(inner, inner).map(lambda pair: Power(*pair)),
        st.tuples(st.sampled_from(["abs", "sqrt", "exp", "log", "sin", "cos", "tan"]), inner.map(lambda x: (x,))).map(
            lambda pair: Call(*pair)
        ),
        st.tuples(inner, inner).map(lambda pair: Call("atan2", pair)),
        st.tuples(st.sampled_from(["norm", "hypot", "sumsqr", "min", "max"]), several).map(lambda pair: Call(*pair)),
    )


others = st.sampled_from([Time(), Steps(), Last("x1"), Last("t")])
small: st.SearchStrategy[Expression] = numbers | st.sampled_from(["x1", "x2"]).map(Name) | others
expressions = st.recursive(small, _larger, max_leaves=8)


@st.composite
def comparisons(draw: st.DrawFn) -> Formula:
    operators = draw(st.sampled_from([("<",), (">=",), ("==",), ("<=", "<"), (">", "=="), ("<=", "==", "<=")]))
    count = len(operators) + 1
    return Comparison(tuple(draw(st.lists(expressions, min_size=count, max_size=count))), operators)


bounds = st.tuples(st.floats(0, 1e6), st.floats(0, 1e3)).map(lambda b: (b[0], b[0] + b[1] + 1e-6))
windows = bounds.filter(lambda b: window_ns(*b)[0] <= window_ns(*b)[1])


def _combined(inner: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    several = st.lists(inner, min_size=2, max_size=3).map(tuple)
    return st.one_of(
        several.map(And),
        several.map(Or),
        inner.map(Not),
        st.tuples(inner, inner).map(lambda pair: Implies(*pair)),
        st.tuples(windows, inner).map(lambda pair: Always(*pair[0], pair[1])),
        st.tuples(windows, inner).map(lambda pair: Eventually(*pair[0], pair[1])),
        st.tuples(windows, inner, inner).map(lambda triple: Until(*triple[0], *triple[1:])),
    )


formulas = st.recursive(comparisons() | st.sampled_from([P, Q]), _combined, max_leaves=6)


@given(formulas)
@pytest.mark.slow
def test_what_is_printed_reads_back(formula: Formula) -> None:
    assert parse(str(formula)) == formula


@given(st.floats(0, allow_infinity=False))
def test_numbers_are_printed_exactly(value: float) -> None:
    assert float(number_text(value)) == value


WORDS = (
    "always G_ [0:1] [ 0 : 1 ( ) P x1 >= < == + - * / ^ and or not F[0:1] U -> abs( norm( , 2.5 1e9 T ms in( t k last("
)
words = st.sampled_from([*WORDS.split(), "\n", " ", "1 s]"])


@given(st.text() | st.lists(words).map("".join) | st.lists(words).map(" ".join))
def test_any_text_is_read_or_refused(text: str) -> None:
    with suppress(ScenarioError):
        formula = parse(text)
        assert parse(str(formula)) == formula


@given(formulas, st.integers(0, 10**6), st.sampled_from(WORDS.split()), st.integers(0, 3))
def test_any_mutated_formula_is_read_or_refused(formula: Formula, place: int, piece: str, cut: int) -> None:
    text = str(formula)
    place %= len(text) + 1
    with suppress(ScenarioError):
        mutated = parse(text[:place] + piece + text[place + cut :])
        assert parse(str(mutated)) == mutated
