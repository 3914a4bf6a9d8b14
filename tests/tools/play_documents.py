"""Play what people type: every shell and Python block of the documents, and every target of ``make help``.

    python -m tests.tools.play_documents            # all that can be played here: an hour; changes nothing in the tree
    python -m tests.tools.play_documents --list     # what is played, and why the rest is not
    python -m tests.tools.play_documents tutorial "make docs"   # what has one of these words in its name

Lines of shell blocks run in a shell, page by page, in a folder with what the pages suppose to be there; Python blocks
as scripts. It ends with 1 if something fails, is in no table, or leaves the tree other than it was. It needs
``make setup-all``: pages show what takes extras.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from clutch_results.records import Condition
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_backend.writer import Batch, Writer
from studies.builders import written
from tests.support.documents import PAGES, ROOT, Shown, block_lines, page_text
from tests.support.fleet import fleet_result, row_of

CAN: Final = "needs a CAN interface"
CAR: Final = "needs a car"
BROKER: Final = "needs a broker of another host, with certificates"
CLUSTER: Final = "needs a cluster"
DOCKER: Final = "needs Docker"
DATABASE: Final = "needs a database server of another host"
NETWORK: Final = "asks the network"
SERVER: Final = "serves until it is stopped"
MACHINE: Final = "changes the machine or the checkout"
MINUTES: Final = "takes minutes: the test plays a shorter one"
RULES: Final = "needs files that only the reader has"
TARGET: Final = "is played as a target of make help"


@dataclass(frozen=True, slots=True)
class Elsewhere:
    """Why something is not played here, and what plays or checks its like."""

    reason: str
    place: str


LINES: Mapping[str, Elsewhere] = {
    "make": Elsewhere(TARGET, "tests/tools/play_documents.py"),
    ".venv/bin/pre-commit": Elsewhere(MACHINE, ".pre-commit-config.yaml"),
    "sudo modprobe": Elsewhere(CAN, "tests/uml/vcan.py"),
    "diag-service run": Elsewhere(CAN, "tests/e2e/test_vcan_drive.py"),
    "diag-service try": Elsewhere(CAR, "tests/integration/test_trying.py"),
    **dict.fromkeys(
        ("diag-service dtc", "diag-service did", "diag-service routine", "diag-service scan"),
        Elsewhere(CAN, "tests/integration/test_tester.py"),
    ),
    "diag-service analyze s3://fleet/logs": Elsewhere(CLUSTER, "tests/e2e/test_cluster.py"),
    "dask": Elsewhere(CLUSTER, "tests/e2e/test_cluster.py"),
    "diag-service analyze logs --lake": Elsewhere(RULES, "tests/integration/test_lake.py"),
    "diag-service lake": Elsewhere(RULES, "tests/integration/test_lake.py"),
    "diag-service monitor": Elsewhere(CAN, "tests/integration/test_service_onlookers.py"),
    "ecu-emulator run": Elsewhere(CAN, "tests/e2e/test_vcan_drive.py"),
    "ecu-emulator control": Elsewhere(CAN, "tests/integration/test_emulator_control.py"),
    "docker compose": Elsewhere(DOCKER, "tests/unit/test_dashboards.py"),
    "candump": Elsewhere(CAN, "tests/integration/test_candump_pipe.py"),
    "ecu-emulator record city.log": Elsewhere(MINUTES, "tests/integration/test_road_drive.py"),
    "export": Elsewhere(DATABASE, "tests/integration/test_fleet_cli.py"),
    "fleet-backend ingest": Elsewhere(BROKER, "tests/e2e/test_fleet_chaos.py"),
    "fleet-backend follow": Elsewhere(BROKER, "tests/integration/test_follow.py"),
    "fleet-backend partitions": Elsewhere(DATABASE, "tests/integration/test_fleet_months.py"),
    "fleet-backend serve": Elsewhere(SERVER, "tests/integration/test_fleet_page.py"),
    "fleet-backend watch": Elsewhere(SERVER, "tests/integration/test_fleet_alarms.py"),
    "fleet-backend alarms --acknowledge": Elsewhere(RULES, "tests/integration/test_fleet_cli.py"),
    "curl": Elsewhere(SERVER, "tests/integration/test_fleet_page.py"),
    "pip install": Elsewhere(NETWORK, "tests/integration/test_canlog_alone.py"),
    "pip-audit": Elsewhere(NETWORK, "CONTRIBUTING.md"),
    "pg_dump": Elsewhere(DATABASE, "tests/integration/test_fleet_backup.py"),
    "pg_restore": Elsewhere(DATABASE, "tests/integration/test_fleet_backup.py"),
    "python -c": Elsewhere(RULES, "tests/integration/test_fleet_backup.py"),
}
"""Lines of shell blocks that are not played, by their beginning."""

LEFT_TO_OTHERS: Mapping[str, Elsewhere] = {
    "ecu-emulator record -": Elsewhere(MINUTES, "tests/integration/test_piped_logs.py"),
    **dict.fromkeys(
        (
            "ecu-emulator record first.log",
            "diag-service calibrate first.log",
            "ecu-emulator record later.log",
            "diag-service analyze later.log",
        ),
        Elsewhere(MINUTES, "tests/integration/test_calibrate_story.py"),
    ),
    **dict.fromkeys(
        ("diag-service learn", "diag-service analyze drive-b.csv"),
        Elsewhere(MINUTES, "tests/integration/test_learn.py"),
    ),
    "fleet-backend migrate": Elsewhere(MINUTES, "tests/integration/test_fleet_cli.py"),
}
"""What the suite leaves to a test of its own, and this tool plays."""

PYTHON_PAGES: Final = (("docs/python.md", "README.md"),)  # each row in a folder, in this order
BLOCKS: Mapping[tuple[str, str], str] = {
    ("README.md", "python"): "tests/integration/test_python_page.py",
    ("CONTRIBUTING.md", "python"): "tests/integration/test_log_format_recipe.py",
    ("canlog/README.md", "python"): "tests/integration/test_canlog_alone.py",
    ("docs/controller.md", "python"): "tests/integration/test_python_page.py",
    ("docs/fleet.md", "sql"): "tests/integration/test_fleet_backup.py",
    ("docs/logs.md", "python"): "tests/integration/test_python_page.py",
    ("docs/logs.md", "sql"): "tests/integration/test_decode_formats.py",
    ("docs/operations.md", "sql"): "tests/integration/test_lake.py",
    ("docs/own-car.md", "toml"): "tests/integration/test_python_page.py",
    ("docs/python.md", "python"): "tests/integration/test_python_page.py",
    ("docs/sovd.md", "python"): "tests/integration/test_sovd.py",
    ("docs/verdict.md", "python"): "tests/integration/test_python_page.py",
    ("examples/gateway/README.md", "console"): "tests/integration/test_image_example.py",
}
"""Which test runs the blocks of a page that are no shell's; one of no language is a drawing, or what was printed."""

TARGETS: Mapping[str, Sequence[str] | Elsewhere] = {
    "setup": (),
    "setup-all": (),
    "demo": ("OUTPUT={folder}/demo",),
    "fleet": ("OUTPUT={folder}/fleet",),
    "docs": (),
    "check": (),
    "test": Elsewhere("is the suite itself", ".ci/run"),
    "bench": (),
    "accuracy": ("SEEDS=1",),
    "reproduce": ("SEEDS=2", "OUTPUT={folder}/reproduce"),
    "operating-curve": ("SEEDS=1", "OUTPUT={folder}/curve"),
    "mismatch": ("SEEDS=1", "OUTPUT={folder}/mismatch"),
    "setup-system": Elsewhere(MACHINE, ".ci/run"),
    "wheels": (),
    "sbom": (),
    "silkit": Elsewhere(MACHINE, ".ci/run"),
    "lock": Elsewhere(NETWORK, "CONTRIBUTING.md"),
}
"""Each target of ``make help`` with the variables with which it is played, or why it is not."""

OWN_FILES: Final = ("drive.log", "car.dbc")  # that some pages make, and others suppose
_BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """What is played at once, in a folder of its own or in the checkout."""

    name: str
    command: Sequence[str]
    is_in_checkout: bool = False


def elsewhere(line: str, *tables: Mapping[str, Elsewhere]) -> Elsewhere | None:
    """Return why a line is not played here; None: it is."""
    starts = (place for table in tables for start, place in table.items() if f"{line} ".startswith(f"{start} "))
    return next(starts, None)


def helped_targets(text: str) -> list[str]:
    """Return the targets that a help text shows, in its order."""
    return list(dict.fromkeys(re.findall(r"^make ([a-z-]+)", text, re.MULTILINE)))


def make_help() -> str:
    return subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, text=True, check=True).stdout


def played_lines(page: str) -> list[Shown]:
    """Return the lines of a page's shell blocks that this tool plays, in their order."""
    return [shown for shown in block_lines(page) if elsewhere(shown.line, LINES) is None]


def unlisted() -> Iterator[str]:
    """Yield what is shown and in no table."""
    shown = set(helped_targets(make_help()))
    yield from (f"make {target} is in no table" for target in sorted(shown - set(TARGETS)))
    yield from (f"make help does not show {target} any more" for target in sorted(set(TARGETS) - shown))
    for page, language in sorted(shown_blocks() - set(BLOCKS)):
        yield f"{page}: a block of {language} is in no table"


def shown_blocks() -> set[tuple[str, str]]:
    """Return pages with the languages of their blocks, but for shells' and for texts, which are output."""
    pages = [*PAGES, *(str(path.relative_to(ROOT)) for path in (ROOT / "examples").rglob("*.md"))]
    language = re.compile(r"^ *```(?!sh$|text$)(\S+)$", re.MULTILINE)
    return {(page, name) for page in pages for name in language.findall(page_text(page))}


def pieces(folder: Path) -> Iterator[Piece]:
    """Yield all that is played, quick ones first."""
    for page in PAGES:
        if lines := played_lines(page):
            script = "set -e\nset -o pipefail\n" + "\n".join(shown.line for shown in lines)
            yield Piece(name=page, command=("bash", "-c", script))
    for pages in PYTHON_PAGES:
        blocks = [text for page in pages for text in _BLOCK.findall(page_text(page))]
        files = [text for text in blocks if "__main__" in text]  # whose processes import the script
        tests = [text for text in blocks if "def test_" in text]  # played in the folder of their example
        rest = "\n".join(text for text in blocks if text not in (*files, *tests))
        for number, text in enumerate((rest, *files)):
            yield Piece(name=f"{', '.join(pages)}: Python {number + 1}", command=_script(text))
    for target, how in TARGETS.items():
        if not isinstance(how, Elsewhere):
            variables = [variable.format(folder=folder) for variable in how]
            yield Piece(name=f"make {target}", command=("make", target, *variables), is_in_checkout=True)


def _script(text: str) -> Sequence[str]:
    return ("bash", "-c", f"cat >script.py <<'END'\n{text}\nEND\npython script.py")


def makes(text: str, name: str) -> bool:
    """Return whether commands or Python make a file of this name, which must not be there before."""
    return re.search(rf'(record[( ]"?|write_dbc\("|dbc -o ){re.escape(name)}', text) is not None


def furnish(folder: Path) -> None:
    """Put into a folder what the pages suppose the reader to have: logs, tables, a database."""
    (folder / "logs").mkdir(parents=True)
    emulator = [sys.executable, "-m", "ecu_emulator"]
    subprocess.run([*emulator, "dbc", "-o", str(folder / "car.dbc")], check=True, capture_output=True)
    for name, seed in (("monday.log", 1), ("tuesday.blf", 2), ("logs/one.log", 3)):
        drive = ["record", str(folder / name), "--scenario", "noise_only", "--cycles", "1", "--seed", str(seed)]
        subprocess.run([*emulator, *drive], check=True, capture_output=True)
    shutil.copy(folder / "monday.log", folder / "drive.log")
    for name, log in (("drive.csv", "monday.log"), ("drive-a.csv", "monday.log"), ("drive-b.csv", "logs/one.log")):
        written(folder / log, folder / name, np.random.default_rng(1), left_out=frozenset())
    for name in ("dynamic-security.json", "nats.conf"):
        shutil.copy(ROOT / "docs" / "deploy" / name, folder)
    shutil.copy(ROOT / "dbc" / "lockup.dbc", folder / "van.dbc")
    (folder / "recordings").mkdir()
    shutil.copy(folder / "monday.log", folder / "recordings" / "drive.log")
    url = f"sqlite:///{folder / 'fleet.sqlite'}"
    engine = open_database(url)
    migrate(engine)
    engine.dispose()
    with_known_vehicle(url)


def with_known_vehicle(url: str) -> None:
    """Store in a fleet's database what its pages suppose: a vehicle whose fluid is to be changed."""
    engine = open_database(url)
    worn = [fleet_result(seq, vehicle="CAR1", condition=Condition.CHANGE_FLUID) for seq in (1, 2, 3)]
    rows = [row_of(result) | {"odometer_m": 80_200_000.0} for result in worn]
    Writer(engine).store(Batch(shifts=rows, quarantined=[]))
    engine.dispose()


def play(piece: Piece, furniture: Path, folder: Path) -> bool:
    """Play a piece, say how it went and how long it took; return whether it ended well."""
    began_s = time.monotonic()
    stage = ROOT
    if not piece.is_in_checkout:
        stage = folder / re.sub(r"\W+", "-", piece.name)
        shutil.copytree(furniture, stage)
        for made in OWN_FILES:
            if makes(piece.command[-1], made):
                (stage / made).unlink()
        if 'Path("recordings").mkdir' in piece.command[-1]:
            shutil.rmtree(stage / "recordings")
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "XDG_STATE_HOME": str(stage / "state") if stage != ROOT else str(folder / "state"),
        "CLUTCHDIAG_DATABASE": f"sqlite:///{stage / 'fleet.sqlite'}",
    }
    done = subprocess.run(
        piece.command, cwd=stage, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    is_good = done.returncode == 0
    print(f"{'ok' if is_good else 'FAILED'}  {piece.name}: {time.monotonic() - began_s:.0f} s", flush=True)
    if not is_good:
        print(f"{done.stdout[-2000:]}{done.stderr[-2000:]}", flush=True)
    return is_good


def tree_state() -> str:
    """Return what git says of the checkout."""
    command = ["git", "status", "--porcelain"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


def listing() -> Iterator[str]:
    """Yield what is played and what is not, with reasons."""
    for page in PAGES:
        for shown in block_lines(page):
            why = elsewhere(shown.line, LINES)
            yield f"{page}: {shown.line}: {'played' if why is None else f'{why.reason} ({why.place})'}"
    played = {page for pages in PYTHON_PAGES for page in pages}
    for (page, language), place in BLOCKS.items():
        is_here = language == "python" and page in played
        yield f"{page}, blocks of {language}: {'played, and in ' if is_here else 'played in '}{place}"
    for target, how in TARGETS.items():
        words = f"{how.reason} ({how.place})" if isinstance(how, Elsewhere) else " ".join(("played", *how))
        yield f"make {target}: {words}"


def main(arguments: Sequence[str] | None = None) -> int:
    """List or play; return 0 if all of it ended well, else 1."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", metavar="WORD", help="play what has one of these in its name")
    parser.add_argument("--list", action="store_true", help="list what is played, and why the rest is not")
    options = parser.parse_args(arguments)
    faults = list(unlisted())
    if options.list:
        print("\n".join((*listing(), *faults)))
        return bool(faults)
    before = tree_state()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        chosen = [
            piece for piece in pieces(folder) if not options.words or any(word in piece.name for word in options.words)
        ]
        furniture = folder / "furniture"
        if any(not piece.is_in_checkout for piece in chosen):
            furnish(furniture)
        faults += [f"{piece.name} failed" for piece in chosen if not play(piece, furniture, folder)]
    if tree_state() != before:
        faults.append("git status is another than before")
    print("\n".join(faults) or f"all of {len(chosen)} ended well; git status is as it was")
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
