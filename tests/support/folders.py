"""A folder of logs, analysed by several processes, killed half-way and started again: no file twice, none missing.

The second run is this process: what it has to go on from is on the disk.
"""

import json
import signal
import subprocess
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from tests.support.in_process import ended
from tests.support.patience import HANG_S
from tests.support.service import PROGRAM, environment

POLL_S = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class KilledRun:
    """What a kill left, and what the second start made of it."""

    done_before: int  # drives in the journal when the first run was killed
    outlived: int  # its processes that did not end with it
    records: tuple[dict[str, Any], ...]  # the output of the second run
    second_stderr: str

    @property
    def files(self) -> Counter[str]:
        """How often each log is in the output."""
        return Counter(path for one in self.records if one["schema"] == "clutchdiag/drive/v1" for path in one["paths"])

    @property
    def shift_keys(self) -> Counter[tuple[str, int]]:
        """How often each shift is in the output."""
        return Counter((one["stream"], one["seq"]) for one in self.records if one["schema"] == "clutchdiag/shift/v1")


def fill_folder(folder: Path, log: Path, count: int) -> list[Path]:
    """Write copies of a candump log, each begun a little later so that all differ, and a file that is no log."""
    lines = log.read_bytes().splitlines(keepends=True)
    folder.mkdir(parents=True)
    (folder / "notes.txt").write_text("not a log\n", encoding="ascii")
    paths = [folder / f"drive{number:03}.log" for number in range(count)]
    for number, path in enumerate(paths):
        path.write_bytes(b"".join(lines[number:]))
    return paths


def kill_and_resume(folder: Path, output: Path, *, jobs: int, kill_after: int) -> KilledRun:
    """Analyse a folder, kill the run when so many drives are done, start it again and return what came of it."""
    journal = output.with_name(f"{output.name}.journal")
    words = ["analyze", str(folder), "--output", str(output), "--jobs", str(jobs)]
    first = subprocess.Popen(
        [*PROGRAM, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment()
    )
    while _line_count(journal) < kill_after:
        if first.poll() is not None:
            raise RuntimeError(f"the run ended by itself with status {first.returncode}")
        time.sleep(POLL_S)
    family = psutil.Process(first.pid).children(recursive=True)
    first.send_signal(signal.SIGKILL)
    first.wait()
    _, alive = psutil.wait_procs(family, timeout=HANG_S)
    done_before = _line_count(journal)
    with journal.open("ab") as file:
        file.write(b'{"schema":"clutchdiag/journal/v1","key":"cut off in the mid')  # as a kill while writing leaves it
    second = ended(*words)
    assert second.status == 0, second.err
    records = tuple(json.loads(line) for line in output.read_text(encoding="utf-8").splitlines())
    return KilledRun(done_before=done_before, outlived=len(alive), records=records, second_stderr=second.err)


def _line_count(path: Path) -> int:
    return path.read_bytes().count(b"\n") if path.exists() else 0
