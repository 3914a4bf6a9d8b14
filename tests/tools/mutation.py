"""How many small faults the tests find, in the five modules where a fault would cost most: a table of the killed share.

A fault is a mutant of cosmic-ray, drawn by a seed; it is killed if one of the module's tests fails. Cosmic-ray is not
in the lock, so it comes for this run alone:

    python -m uv run --no-project --with cosmic-ray==8.7.0 tests/tools/mutation.py --python .venv/bin/python --count 40
"""

import argparse
import os
import random
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from cosmic_ray.ast import ast_nodes, get_ast  # type: ignore[import-not-found]
from cosmic_ray.mutating import mutate_code  # type: ignore[import-not-found]
from cosmic_ray.plugins import get_operator, operator_names  # type: ignore[import-not-found]

LIMIT_S = 180  # of processor time for the tests of one mutant: what turns for ever is found
HANG_S = 300.0  # and what waits for ever: ten times what the slowest of these tests take
SOURCES = (".", "canlog/src", "workshop/src", "fleet/src")
ORDERS = "tests/properties/test_orders.py"
TESTS = {
    "diag_service/diagnosis/friction/balance.py": ("tests/unit/diag_service/diagnosis/friction",),
    "diag_service/diagnosis/condition/verdict.py": ("tests/unit/diag_service/diagnosis/condition", ORDERS),
    "fleet_contract/orders.py": ("tests/unit/fleet_contract", "tests/unit/diag_service/report/test_page.py", ORDERS),
    "diag_service/delivery/outbox.py": (
        "tests/unit/diag_service/delivery",
        "tests/integration/test_acknowledged_outbox.py",
    ),
    "canlog/src/canlog/decode/codec.py": (
        "canlog/tests/canlog_tests/decode",
        "tests/properties/test_message_layouts.py",
    ),
}


class Spot(NamedTuple):
    """The ``occurrence``-th place where an operator can change the module, and its line."""

    operator: str
    occurrence: int
    line: int


def spots(source: str) -> list[Spot]:
    """Return where the module can be changed; imports and the bars of types are left out, as they do not run."""
    nodes, lines = list(ast_nodes(get_ast(source))), source.splitlines()
    found = []
    for name in sorted(operator_names()):
        try:
            operator = get_operator(name)()
        except TypeError:  # one that wants arguments
            continue
        starts = [start for node in nodes for start, _ in operator.mutation_positions(node)]
        found += [Spot(name, occurrence, line) for occurrence, (line, _) in enumerate(starts)]
    return [
        spot for spot in found
        if "import" not in lines[spot.line - 1] and not ("BitOr" in spot.operator and "| None" in lines[spot.line - 1])
    ]  # fmt: skip


def is_killed(python: str, tree: Path, tests: list[str]) -> bool:
    """Return whether a test fails in this tree, whose modules hide those that are installed."""
    command = [python, "-m", "pytest", "-x", "-q", "-n0", "-p", "no:cacheprovider", "--hypothesis-seed=0", *tests]
    path = os.pathsep.join(str(tree / source) for source in SOURCES)
    limited = ["prlimit", f"--cpu={LIMIT_S}", *command]
    try:
        ended = subprocess.run(
            limited, cwd=tree, env=os.environ | {"PYTHONPATH": path}, capture_output=True, timeout=HANG_S, check=False
        )
    except subprocess.TimeoutExpired:
        return True
    return ended.returncode != 0


def survivors(python: str, tree: Path, module: str, tests: list[str], count: int) -> tuple[int, list[str]]:
    """Return how many mutants of a module were tried in a copy of the tree, and those that no test found."""
    source = (tree / module).read_text(encoding="utf-8")
    places = spots(source)
    lived: list[str] = []
    with TemporaryDirectory(prefix="mutation-") as folder:
        copy = Path(folder) / "tree"
        shutil.copytree(tree, copy, ignore=shutil.ignore_patterns(".git", ".venv*", "build", "__pycache__", ".*_cache"))
        if is_killed(python, copy, tests):
            raise SystemExit(f"{module}: its tests fail without any fault")
        drawn = random.Random(module).sample(places, min(count, len(places)))  # noqa: S311 - a draw that repeats
        for spot in drawn:
            (copy / module).write_text(mutate_code(source, get_operator(spot.operator)(), spot.occurrence))
            if not is_killed(python, copy, tests):
                line = source.splitlines()[spot.line - 1].strip()
                lived.append(f"  line {spot.line}, {spot.operator.removeprefix('core/')}: {line}")
    return len(drawn), lived


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", default=sys.executable, help="the interpreter that has the project's requirements")
    parser.add_argument("--tree", type=Path, default=Path(), help="another checkout of the project")
    parser.add_argument("--count", type=int, default=40, help="mutants of a module")
    parser.add_argument("--jobs", type=int, default=2, help="modules at once")
    parser.add_argument("--of", nargs="+", metavar="MODULE [TEST ...]", action="append", help="a module and its tests")
    arguments = parser.parse_args()
    chosen = {module: tests for module, *tests in arguments.of or [[name, *of] for name, of in TESTS.items()]}
    python, tree = str(Path(arguments.python).absolute()), arguments.tree.absolute()

    def line(module: str) -> str:
        tried, lived = survivors(python, tree, module, chosen[module], arguments.count)
        share = 100.0 * (tried - len(lived)) / tried
        return "\n".join([f"{module}: {tried - len(lived)} of {tried} killed, {share:.0f} %", *lived])

    with ThreadPoolExecutor(arguments.jobs) as pool:
        for text in pool.map(line, chosen):
            print(text, flush=True)


if __name__ == "__main__":
    main()
