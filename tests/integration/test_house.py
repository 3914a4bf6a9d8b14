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
