"""``candump -L vcan0 | diag-service analyze -``: the real candump on a real vcan, beside the file of ``candump -l``."""

import lzma
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.golden.compare import RECORDINGS
from tests.integration.test_piped_logs import without
from tests.plugins.drives import send_time_s
from tests.support.bus_end import wait_for_listener
from tests.support.in_process import ended
from tests.support.patience import HANG_S
from tests.support.service import PROGRAM, Ended, environment

pytestmark = pytest.mark.vcan

END_S = 4.0  # of the drive: its first gear change is over, the second one goes on
RECEIVE_BYTES = 1 << 24  # for all frames of it: a machine that stands still for a while loses none of them


@contextmanager
def candump(
    *words: str, vcan: str, folder: Path, listener_count: int, output: int
) -> Iterator["subprocess.Popen[bytes]"]:
    """Run can-utils' candump until the block ends; the bus is heard by so many programs when this returns."""
    with subprocess.Popen(["candump", *words, "-r", str(RECEIVE_BYTES), vcan], cwd=folder, stdout=output) as process:
        try:
            wait_for_listener(vcan, listener_count, process)
            yield process
        finally:
            process.terminate()


def piped_analysis(vcan: str, log: Path, folder: Path) -> tuple[Ended, Path]:
    """Play a log on an interface; return what is found through the pipe, and the file that was written beside it."""
    count = str(log.read_bytes().count(b"\n"))  # candump ends by itself after so many frames
    with (
        candump("-l", "-n", count, vcan=vcan, folder=folder, listener_count=1, output=subprocess.DEVNULL) as logging,
        candump("-L", "-n", count, vcan=vcan, folder=folder, listener_count=2, output=subprocess.PIPE) as dump,
        subprocess.Popen(
            [*PROGRAM, "analyze", "-", "--json"], stdin=dump.stdout, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True, env=environment(),
        ) as service,
    ):  # fmt: skip
        try:
            assert dump.stdout is not None
            dump.stdout.close()  # the service alone reads it
            subprocess.run(["canplayer", "-I", str(log), f"{vcan}=vcan0"], check=True, timeout=HANG_S)
            out, err = service.communicate(timeout=HANG_S)
            logging.wait(HANG_S)
        finally:
            service.kill()
    (file,) = folder.glob("candump-*.log")
    return Ended(status=service.returncode, out=out, err=err), file


def test_the_pipe_finds_what_is_in_the_file_to_the_bit(vcan: str, tmp_path: Path) -> None:
    lines = lzma.decompress((RECORDINGS / "ideal.log.xz").read_bytes()).splitlines(keepends=True)
    short, folder = tmp_path / "short.log", tmp_path / "dumped"
    short.write_bytes(b"".join(line for line in lines if send_time_s(line) < send_time_s(lines[0]) + END_S))
    folder.mkdir()
    pipe, file = piped_analysis(vcan, short, folder)
    assert pipe.status == 0, pipe.err
    own = ended("analyze", file, "--json")
    assert pipe.summary["frames"] == own.summary["frames"]
    # A machine that stands still stamps late, which rightly costs a shift its estimate: found alike is what is asked.
    assert own.shifts
    assert without(pipe.shifts, "stream") == without(own.shifts, "stream")
    assert without(pipe.summary["clutches"], "stream") == without(own.summary["clutches"], "stream")
