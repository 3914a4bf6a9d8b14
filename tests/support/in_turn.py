"""Runs commands of any program one after another in this process: ``python -m tests.support.in_turn < commands.json``.

Standard input is a list of commands, each a list of words; standard output the list of what each left: exit status and
standard error. One process with few rights, as strangers.WRAPPER makes it, so runs many commands.
"""

import contextlib
import io
import json
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import diag_service.cli
import ecu_emulator.cli
import fleet_backend.cli
from tests.support.patience import HANG_S

MAINS = {
    "diag-service": diag_service.cli.main,
    "ecu-emulator": ecu_emulator.cli.main,
    "fleet-backend": fleet_backend.cli.main,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Left:
    """What a command left."""

    command: str
    status: int
    err: str


def in_turn(commands: Sequence[Sequence[str | Path]], folder: Path, wrapper: Sequence[str] = ()) -> list[Left]:
    """Run commands, the first word of each being the program, in a folder, and return what they left."""
    words = [[str(word) for word in command] for command in commands]
    run = [*wrapper, sys.executable, "-m", "tests.support.in_turn", str(folder)]
    done = subprocess.run(run, input=json.dumps(words), capture_output=True, text=True, timeout=HANG_S, check=False)
    assert done.returncode == 0, done.stderr
    return [
        Left(command=" ".join(command), status=status, err=err)
        for command, (status, err) in zip(words, json.loads(done.stdout), strict=True)
    ]


def _left(program: str, *words: str) -> tuple[int, str]:
    err = io.StringIO()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)}
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(err):
        status = MAINS[program](list(words))
    for number, handler in before.items():
        signal.signal(number, handler)
    return status, err.getvalue()


if __name__ == "__main__":
    asked = json.load(sys.stdin)
    with contextlib.chdir(sys.argv[1]):
        left = [_left(*words) for words in asked]
    json.dump(left, sys.stdout)
