"""The first moments of a program: a signal while it is loading."""

import signal
import subprocess
import sys
from importlib.metadata import distribution
from pathlib import Path

import pytest

from tests.support.patience import HANG_S

REPOSITORY = Path(__file__).parents[2]
START = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "  # which nohup leaves ignored
    "from clutchdiag_io.start import run_program; sys.exit(run_program('slow_program'))"
)
LOADING = f"import time\nprint('here', flush=True)\ntime.sleep({HANG_S})\n"
RUNNING = f"import time\ndef main():\n    print('here', flush=True)\n    time.sleep({HANG_S})\n"
ASKING = "import click\ndef main():\n    print('here', flush=True)\n    raise click.Abort\n"


def signalled(folder: Path, source: str, sent: signal.Signals, start: str, *words: str) -> tuple[int, str, str]:
    """Return how a program ends that gets a signal as soon as it has begun, and what it says from then on."""
    (folder / "slow_program.py").write_text(source, encoding="utf-8")
    command, place = [sys.executable, "-c", start, *words], {"PYTHONPATH": f"{folder}:{REPOSITORY}"}
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=place, stdout=pipe, stderr=pipe, text=True) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "here\n"
        program.send_signal(sent)
        out, err = program.communicate(timeout=HANG_S)
    return program.returncode, out, err


@pytest.mark.parametrize("source", [LOADING, RUNNING, ASKING], ids=["loading", "running", "asking"])
def test_ctrl_c_ends_a_program_that_heeds_nothing_yet_without_a_word(tmp_path: Path, source: str) -> None:
    assert signalled(tmp_path, source, signal.SIGINT, START) == (130, "", "")


def test_it_is_hardly_looked_for_garbage_while_a_program_loads_nor_when_it_ends(tmp_path: Path) -> None:
    """Classes and functions refer to themselves in circles, and none of them is garbage."""
    source = "kept = [[] for _ in range(400_000)]\ndef main():\n    return 0\n"
    (tmp_path / "slow_program.py").write_text(source, encoding="utf-8")
    told = "print(sum(one['collections'] for one in gc.get_stats()), gc.get_freeze_count())"
    code = f"import gc; {START.replace('sys.exit', 'status = ')}; {told}"
    run = subprocess.run(
        [sys.executable, "-c", code], env={"PYTHONPATH": f"{tmp_path}:{REPOSITORY}"}, capture_output=True, check=True
    )
    search_count, settled_count = map(int, run.stdout.split())
    assert search_count < 100  # 650 by the interpreter's own measure
    assert settled_count > 400_000


@pytest.mark.parametrize(("word", "status"), [("serve", 0), ("table", -signal.SIGTERM)])
def test_a_service_that_is_stopped_while_it_loads_ends_well(tmp_path: Path, word: str, status: int) -> None:
    start = START.replace("'slow_program'", "'slow_program', ('serve',)")
    assert signalled(tmp_path, LOADING, signal.SIGTERM, start, word)[0] == status


def test_every_program_begins_so_and_loads_nothing_of_others_before() -> None:
    points = [*distribution("clutchdiag").entry_points, *distribution("clutchdiag-fleet").entry_points]
    scripts = [one for one in points if one.group == "console_scripts"]
    assert len(scripts) == 3
    for one in scripts:
        code = (
            f"import sys; before = set(sys.modules); from {one.module} import {one.attr}; "
            "print({name.partition('.')[0] for name in set(sys.modules) - before} - sys.stdlib_module_names)"
        )
        told = subprocess.run(
            [sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=True, timeout=HANG_S
        )
        loaded = eval(told.stdout)  # noqa: S307 - what the line above printed
        assert loaded <= {"canlog", "clutchdiag_io", one.module.partition(".")[0]}
