"""What keeps the house readable: modules that fit one's head, kernels that take records and not a dozen arrays."""

import ast
from collections import defaultdict
from collections.abc import Iterator

import pytest

from tests.support.distributions import PACKAGES, ROOT, modules_of

ROOMS = ["studies", "demo", *PACKAGES]
MOST_LINES = 600
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


def test_kernels_are_found() -> None:
    found = {one.name: parameters(one) for _, text in modules("canlog") for one in kernels(text)}
    assert len(found) > 20
    many = ast.parse("@kernel\ndef f(a, b, c, d, e, /, g, h, i, *, j, k): ...")
    assert [parameters(one) for one in kernels(ast.unparse(many))] == [10]


def test_tests_of_a_vcan_are_where_make_test_looks_for_them() -> None:
    mark = "pytest.mark." + "vcan"
    users = {
        path.relative_to(ROOT).parts[1]
        for path in (ROOT / "tests").rglob("test_*.py")
        if mark in path.read_text("utf-8")
    }
    assert users <= {"e2e", "integration"}
