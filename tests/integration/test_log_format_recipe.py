"""The recipe of CONTRIBUTING.md for a log format, carried out in a copy of the tree: in the files that it names."""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from canlog.frames import TX_FLAG
from tests.integration.test_house import bound_twice
from tests.support.documents import ROOT, page_text

PROGRAMS = "canlog/src/canlog/logs/columns/programs.py"
GRAMMARS = "tests/support/wild_grammars.py"
ROW = re.compile(r"^\| `([^`]+\.py)` \| `(\w+)` \| `([^`]+)` \|$", re.MULTILINE)
LINE_OF_A_FRAME = """\
def _plain(_: int, frame: Frame) -> str:
    time = f"{START_S + frame.t_us // 1_000_000}.{frame.t_us % 1_000_000:06d}"
    direction = "tx" if frame.is_sent else "rx"
    return f"{time} {frame.channel} {id_text(frame, 3)} {direction} {frame.length} {hex_text(frame)}"


"""
LOG = """# plain-can 1
1767225600.001000 1 0B0 rx 2 51 D0
1767225600.5 2 18FEF100 tx 1 07
1.5 1 0B0 rx 2 51
"""
READ = """
import sys
from canlog.logs import read_log
from canlog.frames import join

reader = read_log(sys.argv[1])
batch = join(list(reader))
print(reader.format, batch.t_ns.tolist(), batch.can_id.tolist(), batch.channel.tolist(), batch.flags.tolist())
print([bytes(row[:length]).hex() for row, length in zip(batch.data, batch.length)])
print(reader.counts.skipped, reader.counts.rejected)
"""


def recipe() -> str:
    text = page_text("CONTRIBUTING.md")
    return text[text.index("### A log format") : text.index("### An effect")]


def add_last(path: Path, name: str, line: str) -> None:
    """Add a line behind the last member of the class, or at the end of the mapping, of a name."""
    text = path.read_text(encoding="utf-8")
    (node,) = (
        node
        for node in ast.parse(text).body
        if (isinstance(node, ast.ClassDef) and node.name == name)
        or (isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == name)
    )
    members = [part for part in getattr(node, "body", ()) if isinstance(part, ast.Assign)]
    end = members[-1].end_lineno if members else node.end_lineno
    assert end is not None
    lines = text.splitlines(keepends=True)
    lines.insert(end - isinstance(node, ast.AnnAssign), f"    {line}\n")
    path.write_text("".join(lines), encoding="utf-8")


@pytest.fixture(name="tree", scope="module")
def _tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the tree in which the recipe was carried out."""
    tree = tmp_path_factory.mktemp("recipe")
    for folder in ("canlog", "tests"):
        shutil.copytree(ROOT / folder, tree / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for file in ("conftest.py", "pyproject.toml"):
        shutil.copy(ROOT / file, tree)
    (block,) = re.findall(r"^```python\n(.*?)^```", recipe(), re.MULTILINE | re.DOTALL)
    with (tree / PROGRAMS).open("a", encoding="utf-8") as programs:
        programs.write(f"\n\n{block}")
    rows = ROW.findall(recipe())
    assert len(rows) == 3
    for file, name, line in rows:
        add_last(tree / file, name, line)
    grammars = (tree / GRAMMARS).read_text(encoding="utf-8")
    (tree / GRAMMARS).write_text(grammars.replace("TABLE_NAMES = (", f"{LINE_OF_A_FRAME}TABLE_NAMES = ("))
    return tree


def run(tree: Path, *command: str) -> str:
    """Run a command whose modules are those of a copy of the tree."""
    path = os.pathsep.join([str(tree / "canlog" / "src"), str(tree), str(ROOT)])
    done = subprocess.run(
        [sys.executable, *command],
        cwd=tree,
        env=os.environ | {"PYTHONPATH": path},
        text=True,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_a_log_is_read_by_the_recipe(tree: Path) -> None:
    (tree / "drive.log").write_text(LOG, encoding="ascii")
    shown = run(tree, "-c", READ, "drive.log").splitlines()
    times_ns, identifiers = [1_767_225_600_001_000_000, 1_767_225_600_500_000_000], [0x0B0, 0x98FEF100]
    assert shown == [
        f"plain {times_ns} {identifiers} [1, 2] [0, {TX_FLAG}]",
        "['51d0', '07']",
        "1 {<LogReject.MALFORMED: 'malformed'>: 1}",
    ]


def test_random_logs_are_read_by_the_recipe(tree: Path) -> None:
    command = ("-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/properties/test_random_logs.py")
    ended = run(tree, *command, "-k", "plain or clx000")
    assert "5 passed" in ended


def test_the_recipe_breaks_no_rule_of_the_house(tree: Path) -> None:
    changed = {PROGRAMS, *(file for file, _, _ in ROW.findall(recipe()))}
    run(tree, "-m", "ruff", "check", *changed)
    run(tree, "-m", "ruff", "format", "--check", *changed)
    assert bound_twice((tree / PROGRAMS).read_text(encoding="utf-8")) == {}
