"""The launcher that finds or boots a kernel with vcan: what goes in and what comes out."""

import os
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import psutil
import pytest

from tests.support.patience import HANG_S
from tests.uml import run as launcher

REPOSITORY = Path(__file__).parents[2]


def run(*arguments: str, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tests.uml.run", *arguments],
        cwd=REPOSITORY,
        env={**os.environ, **(environment or {})},
        capture_output=True,
        text=True,
        timeout=HANG_S,
        check=False,
    )


@pytest.mark.slow
def test_a_command_finds_vcan0_and_its_surroundings_and_its_status_comes_back(tmp_path: Path) -> None:
    value = "a 'quoted' $value @with odd\tcharacters"
    script = (
        'printf "%s\\n" "$ODD"; pwd; cat /sys/class/net/vcan0/operstate; test -t 1 || echo no terminal;'
        f" echo hello >{tmp_path}/file; echo to stderr >&2; exit 7"
    )
    done = run("--time-limit", str(HANG_S), "--", "sh", "-c", script, environment={"ODD": value})
    first, *rest = done.stdout.splitlines()
    assert first.startswith("vcan: kernel ")
    assert rest == [value, str(REPOSITORY), "unknown", "no terminal", "to stderr"]
    assert (tmp_path / "file").read_text() == "hello\n"
    assert done.returncode == 7


@pytest.mark.slow
def test_the_guest_keeps_to_one_core(tmp_path: Path) -> None:
    """Its processes hand over to each other all the time; two idle cores would take turns to wake up."""
    script = f"touch {tmp_path}/up; while [ ! -e {tmp_path}/seen ]; do sleep 0.1; done"
    command = [sys.executable, "-m", "tests.uml.run", "--force-uml", "--", "sh", "-c", script]
    with subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.DEVNULL) as launched:
        deadline_s = time.monotonic() + HANG_S
        while not (tmp_path / "up").exists():
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
        guests = psutil.Process(launched.pid).children(recursive=True)
        cores = {tuple(guest.cpu_affinity()) for guest in guests if guest.status() != psutil.STATUS_ZOMBIE}
        (tmp_path / "seen").touch()
    assert launched.returncode == 0
    ((_,),) = cores  # the same one for all of them


@pytest.mark.slow
def test_the_time_limit_ends_command_and_guest() -> None:
    done = run("--time-limit", "0.5", "--", "sleep", "1000000")
    assert done.returncode == 124
    assert "time limit reached" in done.stdout


def test_without_any_vcan_the_run_fails_and_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(launcher, "native_vcan", lambda: nullcontext(enter_result=False))
    monkeypatch.setattr("shutil.which", lambda _: None)
    assert launcher.main(["--", "true"]) == 69
    assert "apt-get install user-mode-linux" in capsys.readouterr().out
