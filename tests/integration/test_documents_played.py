"""The commands in the documents' shell blocks are run, page by page, or named with the test that runs their like."""

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
from studies.builders import written
from tests.support.documents import PAGES, ROOT, Shown, block_lines
from tests.support.in_process import workers_here
from tests.tools.play_documents import (
    BLOCKS,
    LEFT_TO_OTHERS,
    LINES,
    OWN_FILES,
    TARGETS,
    Elsewhere,
    elsewhere,
    helped_targets,
    make_help,
    makes,
    shown_blocks,
    unlisted,
    with_known_vehicle,
)
from tests.tools.play_documents import main as play_documents


def _system(program: str, words: Sequence[str]) -> int:
    return subprocess.run([program, *words], check=False, capture_output=True).returncode


PROGRAMS: Mapping[str, Callable[[Sequence[str]], int]] = {
    "ecu-emulator": ecu_emulator.cli.main,
    "diag-service": diag_service.cli.main,
    "fleet-backend": fleet_backend.cli.main,
    **{name: partial(_system, name) for name in ("openssl", "sed")},
}
ELSEWHERE = {**LINES, **LEFT_TO_OTHERS}


def played_lines(page: str) -> list[Shown]:
    return [shown for shown in block_lines(page) if elsewhere(shown.line, ELSEWHERE) is None]


TOGETHER = ("README.md", "docs/tutorial.md")  # which begin with the same log, and say the same of it
PLAYED_PAGES = [TOGETHER, *((page,) for page in PAGES if page not in TOGETHER and played_lines(page))]


@pytest.fixture(name="workshop", scope="module")
def _workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with what the documents suppose to be there: a database, logs, a table."""
    folder = tmp_path_factory.mktemp("documents")
    shutil.copy(ROOT / "dbc" / "dct.dbc", folder / "car.dbc")
    shutil.copy(ROOT / "dbc" / "lockup.dbc", folder / "van.dbc")
    (folder / "logs").mkdir()
    for name, seed in (("monday.log", 1), ("tuesday.blf", 2), ("logs/one.log", 3)):
        drive = ["record", str(folder / name), "--scenario", "noise_only", "--cycles", "1", "--seed", str(seed)]
        assert ecu_emulator.cli.main(drive) == 0
    shutil.copy(folder / "monday.log", folder / "drive.log")
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
    with_known_vehicle(sqlite_url)
    monkeypatch.chdir(stage)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("CLUTCHDIAG_DATABASE", sqlite_url)
    return stage


@pytest.mark.parametrize("pages", PLAYED_PAGES, ids=" ".join)
def test_the_commands_of_a_page_run_in_their_order(
    pages: Sequence[str], stage: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = dict.fromkeys(one.line for page in pages for one in played_lines(page))
    for made in OWN_FILES:
        if makes("\n".join(lines), made):
            (stage / made).unlink()
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
    lines = [shown.line for page in PAGES for shown in block_lines(page)]
    for start, why in ELSEWHERE.items():
        assert any(f"{line} ".startswith(f"{start} ") for line in lines), f"no page shows {start!r} any more"
        assert (ROOT / why.place).exists(), why.place


def test_every_block_and_every_make_target_is_played_or_has_a_reason() -> None:
    assert list(unlisted()) == []
    assert shown_blocks() == set(BLOCKS)
    for place in (*BLOCKS.values(), *(how.place for how in TARGETS.values() if isinstance(how, Elsewhere))):
        assert (ROOT / place).exists(), place


def test_a_new_target_is_missed() -> None:
    assert set(helped_targets(make_help() + "make polish        the car\n")) - set(TARGETS) == {"polish"}


@pytest.mark.parametrize("word", ["docs/verdict.md", "docs/fleet.md", "make sbom"])
def test_the_tool_plays_what_is_quick(word: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert play_documents([word]) == 0
    assert "ended well; git status is as it was" in capsys.readouterr().out
