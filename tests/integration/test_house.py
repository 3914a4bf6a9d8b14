"""What keeps the house readable: modules that fit one's head, kernels that take records, names that mean one thing."""

import ast
from collections import defaultdict
from collections.abc import Iterator

import pytest

from tests.support.distributions import PACKAGES, ROOT, modules_of

ROOMS = ["studies", "demo", *PACKAGES]
MOST_LINES = 600
TREE = [*ROOMS, "examples", "tests", *(f"{folder}/tests" for folder in ("canlog", "can_silkit", "workshop", "fleet"))]
MOST_PARAMETERS = 9  # of a kernel: beyond it a record says what belongs together


def modules(room: str) -> Iterator[tuple[str, str]]:
    for path in modules_of(room):
        yield str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")


def kernels(text: str) -> Iterator[ast.FunctionDef]:
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef) and any(
            ast.unparse(one).split("(")[0] in {"kernel", "part"} for one in node.decorator_list
        ):
            yield node


def parameters(function: ast.FunctionDef) -> int:
    return len(function.args.posonlyargs + function.args.args + function.args.kwonlyargs)


def bindings(node: ast.AST) -> Iterator[tuple[str, str]]:
    """Yield the names that a module binds outside of its functions, classes and comprehensions, and where."""
    for child in ast.iter_child_nodes(node):
        match child:
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                yield child.name, f"line {child.lineno}"
            case ast.ListComp() | ast.SetComp() | ast.DictComp() | ast.GeneratorExp() | ast.Lambda():
                pass
            case ast.Import(names=names):  # two modules of a package bind its name to the same
                for alias in names:
                    package = alias.name.partition(".")[0]
                    yield alias.asname or package, alias.name if alias.asname else f"package {package}"
            case ast.ImportFrom(names=names):
                yield from ((alias.asname or alias.name, f"line {child.lineno}") for alias in names)
            case ast.Name(id=name, ctx=ast.Store()):
                yield name, f"line {child.lineno}"
            case _:
                yield from bindings(child)


def bound_twice(text: str) -> dict[str, list[str]]:
    places: dict[str, dict[str, None]] = defaultdict(dict)
    for name, place in bindings(ast.parse(text)):
        places[name][place] = None
    return {name: list(of_name) for name, of_name in places.items() if len(of_name) > 1}


@pytest.mark.parametrize(
    ("text", "twice"),
    [
        ("from a import S\nS = 5\n", {"S": ["line 1", "line 2"]}),
        ("S = {}\nS |= {1: 2}\n", {"S": ["line 1", "line 2"]}),
        ("A, S = 1, 2\nif A:\n    S: int = 3\n", {"S": ["line 1", "line 3"]}),
        ("import s\nfor s in ():\n    pass\n", {"s": ["package s", "line 2"]}),
        ("def s(): ...\nclass s: ...\n", {"s": ["line 1", "line 2"]}),
        ("import s.a\nimport s.b\nX = [s for s in ()]\ndef f():\n    s = 3\n", {}),
    ],
)
def test_a_name_that_is_bound_twice_is_noticed(text: str, twice: dict[str, list[str]]) -> None:
    assert bound_twice(text) == twice


@pytest.mark.parametrize("room", TREE)
def test_a_name_is_bound_once_in_its_module(room: str) -> None:
    twice = {name: bound_twice(text) for name, text in modules(room)}
    assert twice
    assert {name: names for name, names in twice.items() if names} == {}


@pytest.mark.parametrize("room", ROOMS)
def test_no_module_outgrows_its_one_subject(room: str) -> None:
    lengths = {name: len(text.splitlines()) for name, text in modules(room)}
    assert lengths
    assert {name: lines for name, lines in lengths.items() if lines > MOST_LINES} == {}


@pytest.mark.parametrize("room", ROOMS)
def test_no_kernel_takes_ten_parameters(room: str) -> None:
    counts = {f"{name}:{one.name}": parameters(one) for name, text in modules(room) for one in kernels(text)}
    assert {name: count for name, count in counts.items() if count > MOST_PARAMETERS} == {}


def test_a_public_class_has_its_name_for_itself() -> None:
    homes = defaultdict(list)
    for room in ("studies", *PACKAGES):
        for module, text in modules(room):
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    homes[node.name].append(module)
    assert len(homes) > 500
    assert {name: where for name, where in homes.items() if len(where) > 1} == {}
