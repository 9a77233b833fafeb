"""Every public name is on the Python page, and its docstring says what style.md asks for: shapes, errors, exactness,
source."""

import ast
import functools
import importlib
import inspect
import re
import textwrap
import typing
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import ArrayLike

from fleet_bus.errors import FleetError
from reach_server.sets import ConstrainedZonotope, Interval, Zonotope
from tests.docs.test_docs import DOCS, PACKAGES, ROOT, page, section

PAGE = DOCS / "reference" / "python.md"
#: Packages whose ``__all__`` is public.
FACADES = (
    "fleet_bus", "fleet_bus.messages", "reach_server", "reach_server.sets", "reach_server.predicates",
    "reach_server.methods", "reach_server.models.conformal", "side_info", "side_info.progression", "side_info.schemas",
    "fleet_bus.schemas", "fleet_lab.evaluation", "fleet_lab.identification", "vehicle_agent",
)  # fmt: skip
#: Further names that other programs rely on.
PROMISED = ("fleet_bus.router.Router", "fleet_bus.errors.RecordingError", "fleet_bus.errors.ProfileError")
#: Name → keys of docs/references.md that its docstring, or that of its class or module, must give.
DUE = {
    "reach_server.sets.Zonotope.minkowski_sum": ("Gir05",),
    "reach_server.sets.Zonotope.convex_hull": ("Gir05",),
    "reach_server.sets.Zonotope.intersect_strip": ("ABC05", "ABC06"),
    "reach_server.sets.Zonotope.intersect_linearised": ("AJS+22",),
    "reach_server.sets.Zonotope.reduce_order": ("Gir05", "Com03", "KSA17", "SDB+16"),
    "reach_server.sets.Zonotope.volume": ("GK10",),
    "reach_server.sets.Zonotope.contains_set": ("ST19",),
    "reach_server.sets.ConstrainedZonotope": ("SDB+16",),
    "reach_server.sets.ConstrainedZonotope.convex_hull": ("RK22",),
    "reach_server.sets.ConstrainedZonotope.intersect_strip": ("AJS+22",),
    "reach_server.sets.ConstrainedZonotope.intersection": ("SDB+16",),
    "reach_server.sets.ConstrainedZonotope.reduce_order": ("SDB+16",),
    "reach_server.sets.ConstrainedZonotope.reduce_constraints": ("SDB+16",),
    "reach_server.sets.ConstrainedZonotope.rescale": ("SDB+16",),
    "reach_server.sets.ConstrainedZonotope.contains_set": ("ST19",),
    "reach_server.sets.Interval": ("Moo66",),
    "reach_server.data.reservoir.Reservoir": ("Gon85",),
    "reach_server.models.residual_model.residual_set": ("AJS+22", "MN04"),
    "reach_server.models.matrix_zonotope.fit": ("AKA+21",),
    "reach_server.models.bound_estimation.consistent_bounds": ("MN04", "Kel60"),
    "fleet_lab.paper.algorithm_1.Printed": ("AJS+22",),
    "reach_server.models.conformal.ConformalPredictor": ("VGS05",),
    "reach_server.predicates.Literals": ("Alt10", "Moo66"),
    "side_info.progression.Table": ("BK00", "Wol85"),
    "side_info.Formula": ("MaN04",),
}
#: Whether what comes back is the true result, or a bound of it and on which side.
EXACTNESS = re.compile(r"\b(exact|outer|inner|certain|certainly)\b")
#: ``(..., n, g)``, ``(T,)``, ``(V, T, n + 1)``; a word in brackets alone is no shape.
SHAPE = r"\((?:\.\.\.|(?=[^()]*,)[\w\s+*-]+)(?:,\s*[\w\s+*-]*)*\)"


class Public(NamedTuple):
    """A public name, what it stands for, and the class that it belongs to."""

    name: str
    value: Any
    owner: type | None = None

    @property
    def text(self) -> str:
        """The docstring, with that of its class."""
        return "\n".join(inspect.getdoc(item) or "" for item in (self.value, self.owner) if item is not None)


def found(name: str) -> Any:
    """What a dotted name stands for; of a module and another thing of that name the module."""
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        try:
            value: Any = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        return functools.reduce(getattr, parts[k:], value)
    raise ModuleNotFoundError(name)


def own_names(module: ModuleType) -> list[str]:
    """Names that a module defines for others: those of ``__all__``, else what is its own and has no underscore."""
    listed = getattr(module, "__all__", None)
    if listed is not None:
        return sorted(listed)
    return [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", None) == module.__name__
    ]


@functools.cache
def on_page() -> dict[str, Any]:
    """Dotted name → value, of all that the page shows."""
    shown: dict[str, Any] = {}
    for entry in re.split(r"^::: ", PAGE.read_text(encoding="utf-8"), flags=re.M)[1:]:
        name, _, options = entry.partition("\n")
        value = found(name)
        if not inspect.ismodule(value):
            shown[name] = value
            continue
        members = re.search(r"^ +members:\s*\[([^\]]*)\]", options, re.M)
        names = re.findall(r"[\w.]+", members[1]) if members else own_names(value)
        shown |= {f"{name}.{member}": found(f"{name}.{member}") for member in names}
    return shown


def unwrapped(value: Any) -> Any:
    """The function behind a method, a property or a cache."""
    if isinstance(value, property | functools.cached_property):
        return value.fget if isinstance(value, property) else value.func
    return inspect.unwrap(getattr(value, "__func__", value))


def members(owner: type) -> Iterator[Public]:
    """Methods and properties of a public class that it, or a base of this project, defines."""
    for base in owner.__mro__:
        if base.__module__.partition(".")[0] in PACKAGES:
            for name, value in vars(base).items():
                target = unwrapped(value)
                if not name.startswith("_") and inspect.isfunction(target):
                    yield Public(f"{owner.__name__}.{name}", target, owner)


def walk() -> list[Public]:
    names = [Public(name, unwrapped(value)) for name, value in on_page().items()]
    return names + [member for item in names if inspect.isclass(item.value) for member in members(item.value)]


NAMES = [item for item in walk() if inspect.isclass(item.value) or inspect.isfunction(item.value)]
CALLS = [item for item in NAMES if inspect.isfunction(item.value)]


def violations(wrong: Callable[[Public], str | None], items: list[Public] = NAMES) -> list[str]:
    return sorted({f"{item.name}: {reason}" for item in items if (reason := wrong(item))})


def test_the_walk_sees_what_is_public() -> None:
    seen = {item.name for item in NAMES}
    assert {"reach_server.Engine", "Engine.step", "Zonotope.volume", "fleet_bus.keys.state"} <= seen
    assert len(CALLS) > 150


def test_every_public_name_is_on_the_page() -> None:
    shown = on_page()
    values = {id(value) for value in shown.values()}
    modules = {name.rpartition(".")[0] for name in shown}
    missing = []
    for facade in FACADES:
        package = importlib.import_module(facade)
        for name, value in ((name, getattr(package, name)) for name in getattr(package, "__all__", ())):
            # Numbers and texts are no objects of their own: their name must be there. Of a module its names must.
            there = value.__name__ in modules if inspect.ismodule(value) else id(value) in values
            if not (f"{facade}.{name}" in shown if isinstance(value, int | str | tuple) else there):
                missing.append(f"{facade}.{name}")
    missing += [name for name in PROMISED if id(found(name)) not in values]
    assert not missing


def test_no_name_on_the_page_is_hidden_by_a_module() -> None:
    # What is called like a module beside it is taken for that module, of which nothing is shown.
    assert not [name for name, value in on_page().items() if inspect.ismodule(value)]


def test_numbers_on_the_page_have_a_text() -> None:
    """A text below the assignment: without one mkdocstrings leaves the name out."""
    missing = []
    for name, value in on_page().items():
        if not (inspect.isclass(value) or callable(value)):
            last = name.rpartition(".")[2]
            told = re.compile(rf'^{last}\b[^\n]*=(?:[^\n]|\n(?!\n|"""))*\n"""', re.M)
            sources = (path.read_text(encoding="utf-8") for part in PACKAGES for path in (ROOT / part).rglob("*.py"))
            if not any(told.search(source) for source in sources):
                missing.append(name)
    assert not missing


def test_every_name_on_the_page_has_a_docstring() -> None:
    assert not violations(lambda item: None if inspect.getdoc(item.value) else "no docstring")


def is_array(annotation: Any) -> bool:
    """Whether an annotation is that of an array, or of something that may be one."""
    if annotation == ArrayLike or typing.get_origin(annotation) is np.ndarray:
        return True
    return any(is_array(part) for part in typing.get_args(annotation))


def array_names(item: Public) -> list[str]:
    """Array parameters of a function, array fields of a class."""
    if inspect.isclass(item.value):
        fields = inspect.get_annotations(item.value, eval_str=True)
        return [name for name, kind in fields.items() if not name.startswith("_") and is_array(kind)]
    signature = inspect.signature(item.value, eval_str=True)
    return [name for name, parameter in signature.parameters.items() if is_array(parameter.annotation)]


def shapeless(item: Public) -> str | None:
    names = [
        name
        for name in array_names(item)
        # The name, and a shape in the same sentence.
        if not re.search(rf"(?<![\w.]){name}(?!\w)(?:[^.;]|\.\.\.)*?{SHAPE}", item.text)
    ]
    return f"no shape of {', '.join(names)}" if names else None


def test_every_array_has_a_shape() -> None:
    assert not violations(shapeless)


def raised(function: Any) -> set[str]:
    """Names of the errors of this project that the function's own body raises."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise) and node.exc is not None:
            call = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
            name = ast.unparse(call)
            error = function.__globals__.get(name)
            if inspect.isclass(error) and issubclass(error, FleetError):
                names.add(name)
    return names


def unsaid(item: Public) -> str | None:
    functions = [item.value]
    if inspect.isclass(item.value):
        # What making an object may raise belongs to the class, with pydantic's and dataclasses' hooks.
        functions = [
            target
            for name, value in vars(item.value).items()
            if name in ("__init__", "__post_init__", "__new__")
            and inspect.isfunction(target := unwrapped(value))
            # What @dataclass makes has no source.
            and target.__code__.co_filename != "<string>"
        ]
    missing = {error for function in functions for error in raised(function) if error not in item.text}
    return f"does not mention {', '.join(sorted(missing))}" if missing else None


def test_every_error_that_is_raised_is_mentioned() -> None:
    assert not violations(unsaid)


def answers(item: Public) -> bool:
    """Whether a method returns a set, numbers or a truth about sets."""
    kind = inspect.signature(item.value, eval_str=True).return_annotation
    parts = {kind, *typing.get_args(kind)}
    sets = {Zonotope, ConstrainedZonotope, Interval, typing.Self}
    return any(is_array(part) or (isinstance(part, type) and part in sets) or part is typing.Self for part in parts)


@pytest.mark.parametrize("owner", [Zonotope, ConstrainedZonotope, Interval])
def test_every_verb_of_a_set_says_on_which_side_it_errs(owner: type) -> None:
    verbs = [item for item in members(owner) if answers(item)]
    assert len(verbs) > 10
    assert not violations(
        lambda item: None if EXACTNESS.search(inspect.getdoc(item.value) or "") else "exact, outer or inner?", verbs
    )


def test_what_implements_a_published_algorithm_says_which() -> None:
    missing = []
    for name, keys in DUE.items():
        value = found(name)
        sources = [value, found(name.rpartition(".")[0]), importlib.import_module(value.__module__)]
        text = "\n".join(inspect.getdoc(source) or "" for source in sources)
        missing += [f"{name}: {key}" for key in keys if key not in text]
    assert not missing


def test_the_rules_can_fail() -> None:
    def bad(x: ArrayLike) -> None:
        """Nothing said of x."""
        raise FleetError(x)

    def good(x: ArrayLike) -> None:
        """Something of ``x`` (..., n). Raises ``FleetError``."""
        raise FleetError(x)

    assert shapeless(Public("bad", bad)) == "no shape of x"
    assert unsaid(Public("bad", bad)) == "does not mention FleetError"
    assert shapeless(Public("good", good)) is None
    assert unsaid(Public("good", good)) is None


def test_the_table_of_verbs_says_what_the_docstrings_say() -> None:
    table = section(page("concepts/sets.md"), "Verbs").partition("| --- |")[2].partition("\n\n")[0]
    rows = [[cell.strip() for cell in row.split(" | ")] for row in re.findall(r"^\| (`.*) \|$", table, re.M)]
    assert len(rows) > 20
    listed: set[str] = set()
    wrong = []
    for verbs, *cells in rows:
        for verb in re.findall(r"`(\w+)\(", verbs):
            listed.add(verb)
            for owner, cell in zip((Zonotope, ConstrainedZonotope), cells, strict=False):
                text = inspect.getdoc(getattr(owner, verb, None)) or ""
                words = re.findall(r"exact|outer|inner|certain", cell)
                wrong += [f"{owner.__name__}.{verb}: {word}" for word in words if word not in text]
                wrong += [f"{owner.__name__}.{verb}: –" for _ in "x" if cell == "–" and hasattr(owner, verb)]
    assert not wrong
    methods = {item.name.partition(".")[2] for owner in (Zonotope, ConstrainedZonotope) for item in members(owner)}
    assert methods - listed == {"batch", "dimension"}
