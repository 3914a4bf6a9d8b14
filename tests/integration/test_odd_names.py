"""Files whose names are not UTF-8: read, written, named in messages and in JSON, by every program."""

import contextlib
import io
import json
import os
import signal
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import pytest

from dbc.contract import DBC_PATH

ODD = b"log\xe9-\xff[b]"  # Latin-1, no text at all, and what looks like rich's markup
SHOWN = "log\\xe9-\\xff[b]"
CANDUMP = "(1767225600.000000) vcan0 123#0011223344556677\n" * 4


@dataclass(frozen=True, slots=True)
class Told:
    """What a program said."""

    status: int
    out: str
    err: str


def run(module: str, *words: str | Path, cwd: Path) -> Told:
    """Run a program in this process; what it says must be UTF-8, and its streams are as strict as Python's own."""
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", errors) for errors in ("strict", "backslashreplace"))
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)}
    try:
        with contextlib.chdir(cwd), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = import_module(f"{module}.cli").main([str(word) for word in words])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for stream in (out, err):
        stream.flush()
    return checked(status, out.buffer.getvalue(), err.buffer.getvalue())


def checked(status: int, out: bytes, err: bytes) -> Told:
    """Return what a program said, which must be UTF-8 and expected."""
    told = Told(status, out.decode(), err.decode())
    assert "Traceback" not in told.err
    assert "unexpected" not in told.err, told.err
    return told


@pytest.fixture(name="odd")
def _odd(tmp_path: Path) -> Path:
    """Return an odd folder with an odd log."""
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/" + ODD))
    folder.mkdir()
    (folder / odd_name(".log")).write_text(CANDUMP, encoding="utf-8")
    return folder


def odd_name(suffix: str) -> str:
    return os.fsdecode(ODD) + suffix


def strict(line: str) -> dict[str, object]:
    """Return a JSON record, every text of which must be Unicode."""
    record: dict[str, object] = json.loads(line)
    json.dumps(record, ensure_ascii=False).encode()
    return record


def test_a_log_and_a_database_are_read_and_named(odd: Path) -> None:
    log, dbc = odd / odd_name(".log"), odd / odd_name(".dbc")
    dbc.write_bytes(DBC_PATH.read_bytes())
    for command in ("inspect", "analyze", "signals"):
        told = run("diag_service", command, log, "--dbc", dbc, cwd=odd)
        assert told.status == 0, told
        assert command == "analyze" or SHOWN in told.out
    record = strict(run("diag_service", "inspect", "--json", log, cwd=odd).out)
    assert str(record["path"]).endswith(f"/{SHOWN}/{SHOWN}.log")
