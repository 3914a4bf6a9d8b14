"""The first start of a program on a machine says that it compiles, before it does; a signal ends it meanwhile."""

import lzma
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from canlog.live.medium import open_medium
from tests.support.documents import MODULES
from tests.support.patience import HANG_S
from tests.support.service import environment

COMPILING = "first start: compiling, takes about 20 s\n"
FEW_KERNELS = 15  # of some hundred that a drive needs, and of some fifty that a diagnosis needs
RECORDING = Path(__file__).parents[2] / "tests" / "golden" / "recordings" / "case2.log.xz"


@contextmanager
def first_started(folder: Path, *command: str, **variables: str) -> Iterator["subprocess.Popen[str]"]:
    """Start a module with an empty cache."""
    with subprocess.Popen(
        [sys.executable, "-m", *command],
        cwd=folder,
        env={**environment(), "NUMBA_CACHE_DIR": str(folder / "cache"), **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as program:
        try:
            yield program
        finally:
            program.kill()


def ended_by(number: signal.Signals, program: "subprocess.Popen[str]", folder: Path) -> tuple[int, str, int]:
    """Stop a program as it begins to compile; return its status, what else it said, and how many kernels it kept."""
    assert program.stderr is not None
    said = next(line for line in program.stderr if "compiling" in line)
    assert said in {f"{name}: {COMPILING}" for name in MODULES}
    program.send_signal(number)
    _, said = program.communicate(timeout=HANG_S)
    return program.returncode, said, len(list((folder / "cache").rglob("*.nbi")))


@pytest.mark.parametrize(
    ("number", "command"),
    [
        (signal.SIGINT, ("ecu_emulator", "record", "made.log", "--cycles", "1")),
        (signal.SIGTERM, ("diag_service", "analyze", "drive.log", "--store", "made.sqlite")),
    ],
)
def test_a_signal_ends_a_program_that_compiles_and_nothing_is_left(
    command: Sequence[str], number: signal.Signals, tmp_path: Path
) -> None:
    (tmp_path / "drive.log").write_bytes(lzma.decompress(RECORDING.read_bytes()))
    with first_started(tmp_path, *command) as program:
        status, said, kernels = ended_by(number, program, tmp_path)
    assert status == 128 + number, said
    assert "stopped early" in said
    assert kernels < FEW_KERNELS
    assert {path.name for path in tmp_path.iterdir()} == {"cache", "drive.log"}


def test_a_live_service_has_compiled_what_a_first_burst_needs() -> None:
    script = (
        "from canlog.e2e.late_frames import catch_up\n"
        "from diag_service.service.bus_run import warm_up\n"
        "warm_up()\n"
        "print(len(catch_up.compiled.signatures))"
    )
    assert subprocess.check_output([sys.executable, "-c", script], text=True) == "1\n"


def test_a_signal_ends_a_live_service_that_compiles(tmp_path: Path) -> None:
    lines = lzma.decompress(RECORDING.read_bytes()).decode("ascii").splitlines()
    frames = [line.split()[2].split("#") for line in lines]
    is_over = threading.Event()
    with open_medium() as medium, can.Bus(**medium.can_options) as bus:

        def send() -> None:
            while not is_over.is_set():
                for can_id, data in frames:
                    bus.send(
                        can.Message(arbitration_id=int(can_id, 16), data=bytes.fromhex(data), is_extended_id=False)
                    )
                    if is_over.wait(0.0005):
                        return

        sender = threading.Thread(target=send)
        sender.start()
        try:
            words = ("diag_service", "run", *medium.arguments, "--store", "made.sqlite")
            with first_started(tmp_path, *words, **medium.environment) as program:
                status, said, kernels = ended_by(signal.SIGTERM, program, tmp_path)
        finally:
            is_over.set()
            sender.join()
    assert (status, kernels < FEW_KERNELS) == (0, True), said
