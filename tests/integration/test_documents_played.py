"""The commands in the documents' shell blocks are run, page by page, or named with the test that runs their like."""

import re
import shlex
import shutil
import subprocess
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import diag_service.cli
import ecu_emulator.cli
import fleet_backend.cli
from clutch_results.records import Condition
from fleet_backend.database import open_database
from fleet_backend.writer import Batch, Writer
from studies.builders import written
from tests.support.documents import PAGES, ROOT, Shown, block_lines, page_text
from tests.support.fleet import fleet_result, row_of
from tests.support.in_process import workers_here


def _system(program: str, words: Sequence[str]) -> int:
    return subprocess.run([program, *words], check=False, capture_output=True).returncode


PROGRAMS: Mapping[str, Callable[[Sequence[str]], int]] = {
    "ecu-emulator": ecu_emulator.cli.main,
    "diag-service": diag_service.cli.main,
    "fleet-backend": fleet_backend.cli.main,
    **{name: partial(_system, name) for name in ("openssl", "sed")},
}
ELSEWHERE = {
    "make demo": "tests/e2e/test_demo.py",
    "make test": ".ci/run",
    "make check": "Makefile",
    "make setup-all": ".ci/run",
    ".venv/bin/pre-commit": ".pre-commit-config.yaml",
    "sudo modprobe": "tests/uml/vcan.py",
    "diag-service run": "tests/e2e/test_vcan_drive.py",
    "diag-service try": "tests/integration/test_trying.py",
    **dict.fromkeys(
        ("diag-service dtc", "diag-service did", "diag-service routine", "diag-service scan"),
        "tests/integration/test_tester.py",
    ),
    "diag-service analyze s3://fleet/logs": "tests/e2e/test_cluster.py",
    "dask": "tests/e2e/test_cluster.py",
    "diag-service analyze logs --lake": "tests/integration/test_lake.py",
    "diag-service lake": "tests/integration/test_lake.py",
    "diag-service monitor": "tests/integration/test_service_onlookers.py",
    "ecu-emulator run": "tests/e2e/test_vcan_drive.py",
    "ecu-emulator control": "tests/integration/test_emulator_control.py",
    "docker compose": "tests/unit/test_dashboards.py",
    "candump": "tests/integration/test_candump_pipe.py",
    "ecu-emulator record -": "tests/integration/test_piped_logs.py",
    "ecu-emulator record city.log": "tests/integration/test_road_drive.py",
    "ecu-emulator record first.log": "tests/integration/test_calibrate_story.py",
    "diag-service calibrate first.log": "tests/integration/test_calibrate_story.py",
    "ecu-emulator record later.log": "tests/integration/test_calibrate_story.py",
    "diag-service analyze later.log": "tests/integration/test_calibrate_story.py",
    **dict.fromkeys(("diag-service learn", "diag-service analyze drive-b.csv"), "tests/integration/test_learn.py"),
    "export": "tests/integration/test_fleet_cli.py",
    "fleet-backend ingest": "tests/e2e/test_fleet_chaos.py",
    "fleet-backend follow": "tests/integration/test_follow.py",
    "fleet-backend migrate": "tests/integration/test_fleet_cli.py",
    "fleet-backend partitions": "tests/integration/test_fleet_months.py",
    "fleet-backend serve": "tests/integration/test_fleet_page.py",
    "fleet-backend watch": "tests/integration/test_fleet_alarms.py",
    "fleet-backend alarms --acknowledge": "tests/integration/test_fleet_cli.py",
    "curl": "tests/integration/test_fleet_page.py",
    "pip install": "tests/integration/test_canlog_alone.py",
    "pip-audit": "CONTRIBUTING.md",
    "pg_dump": "tests/integration/test_fleet_backup.py",
    "pg_restore": "tests/integration/test_fleet_backup.py",
    "python -c": "tests/integration/test_fleet_backup.py",
}
"""What needs a bus, a broker, root or minutes, by the beginning of its line, and where it is run or checked instead."""


def place_of(line: str) -> str | None:
    """Return where a command is run instead of here; None: here."""
    return next((place for start, place in ELSEWHERE.items() if f"{line} ".startswith(f"{start} ")), None)


def played_lines(page: str) -> list[Shown]:
    return [one for one in block_lines(page) if place_of(one.line) is None]


TOGETHER = ("README.md", "docs/tutorial.md")  # which begin with the same log, and say the same of it
PLAYED_PAGES = [TOGETHER, *((page,) for page in PAGES if page not in TOGETHER and played_lines(page))]


@pytest.fixture(name="workshop", scope="module")
def _workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with what the documents suppose to be there: a database, logs, a table."""
    folder = tmp_path_factory.mktemp("documents")
    shutil.copy(ROOT / "dbc" / "dct.dbc", folder / "car.dbc")
    (folder / "logs").mkdir()
    for name, seed in (("monday.log", 1), ("tuesday.blf", 2), ("logs/one.log", 3)):
        drive = ["record", str(folder / name), "--scenario", "noise_only", "--cycles", "1", "--seed", str(seed)]
        assert ecu_emulator.cli.main(drive) == 0
    for name, log in (("drive.csv", "monday.log"), ("drive-a.csv", "monday.log"), ("drive-b.csv", "logs/one.log")):
        written(folder / log, folder / name, np.random.default_rng(1), left_out=frozenset())
    for name in ("drive-a.csv", "drive-b.csv"):  # to predict each of fewer gear changes is enough
        lines = (folder / name).read_text(encoding="utf-8").splitlines(keepends=True)
        (folder / name).write_text("".join(lines[: len(lines) * 3 // 5]), encoding="utf-8")
    for name in ("dynamic-security.json", "nats.conf"):
        shutil.copy(ROOT / "docs" / "deploy" / name, folder)
    return folder


@pytest.fixture(name="stage")
def _stage(workshop: Path, tmp_path: Path, sqlite_url: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Go to a copy of the workshop, with a fleet of which a vehicle is known and alarms are pending."""
    stage = tmp_path / "stage"
    shutil.copytree(workshop, stage)
    engine = open_database(sqlite_url)
    worn = [fleet_result(seq, vehicle="CAR1", condition=Condition.CHANGE_FLUID) for seq in (1, 2, 3)]
    rows = [row_of(result) | {"odometer_m": 80_200_000.0} for result in worn]
    Writer(engine).store(Batch(shifts=rows, quarantined=[]))
    engine.dispose()
    monkeypatch.chdir(stage)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("CLUTCHDIAG_DATABASE", sqlite_url)
    return stage


@pytest.mark.parametrize("pages", PLAYED_PAGES, ids=" ".join)
def test_the_commands_of_a_page_run_in_their_order(
    pages: Sequence[str], stage: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = dict.fromkeys(one.line for page in pages for one in played_lines(page))
    if not any(one.startswith("ecu-emulator record drive.log") for one in lines):
        shutil.copy("monday.log", "drive.log")  # what a page supposes that does not make one
    for shown in lines:
        line, _, target = shown.partition(" > ")
        program, *words = shlex.split(line)
        with (
            (stage / (target.strip() or "out")).open("w", encoding="utf-8") as out,
            monkeypatch.context() as patch,
            workers_here(),
        ):
            patch.setattr("sys.stdout", out)
            status = PROGRAMS[program](words)
        assert status == 0, shown


def test_what_is_not_run_here_is_run_where_it_is_said() -> None:
    lines = [one.line for page in PAGES for one in block_lines(page)]
    for start, place in ELSEWHERE.items():
        assert any(f"{line} ".startswith(f"{start} ") for line in lines), f"no page shows {start!r} any more"
        assert (ROOT / place).exists(), place


BLOCKS = {
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
"""Where the blocks of a page that are no shell's are run; one of no language is a drawing, or what was printed."""


def test_every_block_of_every_page_is_run_somewhere() -> None:
    pages = [*PAGES, *(str(path.relative_to(ROOT)) for path in (ROOT / "examples").rglob("*.md"))]
    shown = {
        (page, language) for page in pages for language in re.findall(r"^ *```(\S+)$", page_text(page), re.MULTILINE)
    }
    assert {one for one in shown if one[1] not in {"sh", "text"}} == set(BLOCKS)  # text is output
    assert {page for page, language in shown if language == "sh"} <= set(PAGES)
    for place in BLOCKS.values():
        assert (ROOT / place).exists(), place
