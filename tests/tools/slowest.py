"""What each test costs in processor time, its fixtures and the processes that it waited for included; dearest first.

As a plugin it notes the costs of a run, which the load of the machine changes little, as a command it prints them:

    pytest -p tests.tools.slowest --costs FILE tests/integration
    python -m tests.tools.slowest FILE
"""

import argparse
import json
import resource
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--costs",
        type=Path,
        default=None,
        metavar="FILE",
        help="append what each test cost to FILE, a line of JSON each",
    )


def processor_s() -> float:
    """Return the processor time [s] of this process and of those that it has waited for."""
    spent = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in spent)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Note what a test and its fixtures cost."""
    processor, wall = -processor_s(), -time.monotonic()
    outcome = yield
    path: Path | None = item.config.getoption("--costs")
    if path is not None:
        cost = {"test": item.nodeid, "processor_s": processor + processor_s(), "wall_s": wall + time.monotonic()}
        with path.open("a", encoding="utf-8") as costs:
            costs.write(json.dumps(cost) + "\n")
    return outcome


def print_table(path: Path, rows: int, *, by_file: bool) -> None:
    """Print the dearest tests, or files of tests, their processor time [s] and their wall time [s]."""
    processor, wall = Counter[str](), Counter[str]()
    for line in path.read_text().splitlines():
        cost = json.loads(line)
        name = cost["test"].split("::")[0] if by_file else cost["test"]
        processor[name] += cost["processor_s"]
        wall[name] += cost["wall_s"]
    out = sys.stdout
    out.write(f"{processor.total():9.1f} {wall.total():9.1f}  all {len(processor)}\n")
    for name, spent_s in processor.most_common(rows):
        out.write(f"{spent_s:9.2f} {wall[name]:9.2f}  {name}\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--rows", type=int, default=50)
    parser.add_argument("--files", action="store_true", help="by file of tests")
    asked = parser.parse_args()
    print_table(asked.file, asked.rows, by_file=asked.files)
