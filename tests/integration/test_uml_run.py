"""The launcher that finds or boots a kernel with vcan: what goes in and what comes out."""

import os
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import pytest

from tests.uml import run as launcher

REPOSITORY = Path(__file__).parents[2]


def run(*arguments: str, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tests.uml.run", *arguments],
        cwd=REPOSITORY,
        env={**os.environ, **(environment or {})},
        capture_output=True,
        text=True,
        timeout=90,
        check=False,
    )


@pytest.mark.slow
def test_a_command_finds_vcan0_and_its_surroundings_and_its_status_comes_back(tmp_path: Path) -> None:
    value = "a 'quoted' $value @with odd\tcharacters"
    script = (
        'printf "%s\\n" "$ODD"; pwd; cat /sys/class/net/vcan0/operstate; test -t 1 || echo no terminal;'
        f" echo hello >{tmp_path}/file; echo to stderr >&2; exit 7"
    )
    done = run("--time-limit", "60", "--", "sh", "-c", script, environment={"ODD": value})
    first, *rest = done.stdout.splitlines()
    assert first.startswith("vcan: kernel ")
    assert rest == [value, str(REPOSITORY), "unknown", "no terminal", "to stderr"]
    assert (tmp_path / "file").read_text() == "hello\n"
    assert done.returncode == 7


@pytest.mark.slow
def test_the_time_limit_ends_command_and_guest() -> None:
    started_s = time.monotonic()
    done = run("--time-limit", "8", "--", "sleep", "1000")
    assert done.returncode == 124
    assert "time limit reached" in done.stdout
    assert time.monotonic() - started_s < 30


def test_without_any_vcan_the_run_fails_and_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(launcher, "native_vcan", lambda: nullcontext(enter_result=False))
    monkeypatch.setattr("shutil.which", lambda _: None)
    assert launcher.main(["--", "true"]) == 69
    assert "apt-get install user-mode-linux" in capsys.readouterr().out
