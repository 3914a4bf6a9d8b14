"""Files whose names are not UTF-8: read, written, named in messages and in JSON, by every program."""

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import pytest

from dbc.contract import DBC_PATH
from tests.support.patience import HANG_S

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


def run_in_locale(locale: str, module: str, *words: str | Path, cwd: Path) -> Told:
    """Run a program in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", module, *words],
        cwd=cwd,
        env={**os.environ, "LC_ALL": locale},
        capture_output=True,
        timeout=HANG_S,
        check=False,
    )
    return checked(done.returncode, done.stdout, done.stderr)


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


def test_a_log_is_named_in_the_plainest_locale(odd: Path) -> None:
    told = run_in_locale("C", "diag_service", "inspect", odd / odd_name(".log"), cwd=odd)
    assert (told.status, SHOWN in told.out) == (0, True)


def test_tables_are_written_under_such_names(odd: Path) -> None:
    log = odd / odd_name(".log")
    told = run("diag_service", "decode", log, "--json", "-o", odd_name(".parquet"), cwd=odd)
    assert strict(told.out)
    assert (odd / odd_name(".parquet")).read_bytes()[:4] == b"PAR1"
    output = odd / odd_name(".jsonl")
    told = run("diag_service", "analyze", odd, "--json", "--jobs", "1", "-o", output, cwd=odd)
    assert told.status == 0
    again = run("diag_service", "analyze", odd, "--jobs", "1", cwd=odd)
    assert again.out.startswith(f"{odd_text(odd)}.log: ")
    written = output.read_text(encoding="utf-8")  # strict: what is written is UTF-8
    for text in (told.out, written):
        records = [strict(line) for line in text.splitlines()]
        assert [record["paths"] for record in records if "paths" in record] == [[f"{odd_text(odd)}.log"]]


@pytest.mark.parametrize("command", ["analyze", "decode"])
def test_the_longest_names_will_do(command: str, odd: Path) -> None:
    output = odd / ("n" * 251 + ".csv")
    told = run("diag_service", command, odd / odd_name(".log"), "--dbc", DBC_PATH, "-o", output, cwd=odd)
    assert (told.status, output.is_file()) == (0, True)


def odd_text(folder: Path) -> str:
    return f"{folder.parent}/{SHOWN}/{SHOWN}"


def test_a_store_and_a_calibration_have_such_names(odd: Path) -> None:
    log, store, calibration = odd / odd_name(".log"), odd / odd_name(".sqlite"), odd / odd_name(".toml")
    told = run("diag_service", "analyze", log, "--store", store, cwd=odd)
    assert (told.status, store.exists()) == (0, True)
    told = run("diag_service", "history", store, cwd=odd)
    assert (told.status, SHOWN in told.err) == (4, True)  # it is read, and holds no results
    told = run("diag_service", "calibrate", log, "-o", calibration, cwd=odd)
    assert told.status in {2, 3}  # four frames tell nothing of a vehicle
    assert told.err.splitlines()[-1].startswith("diag-service: error: ")
    told = run("diag_service", "config", "check", "--store", store, "--calibration", calibration, cwd=odd)
    assert (told.status, SHOWN in told.err) == (2, True)
    told = run("diag_service", "config", "check", "--store", store, cwd=odd)
    assert told.status == 0


MISSING = (
    "inspect {}",
    "analyze {}",
    "signals {}",
    "calibrate {} -o x.toml",
    "decode {} -o x.parquet",
    "inspect a.log --dbc {}",
    "analyze a.log --config {}",
    "analyze a.log --profile {}",
    "analyze a.log --calibration {}",
    "decode a.log -o {}/none/x.parquet",
    "analyze a.log -o {}.txt",
    "analyze a.log --vehicle {}",
    "analyze a.log --broker mqtts://b --password-file {}",
)


@pytest.mark.parametrize("command", MISSING)
def test_what_is_missing_is_said_in_one_line(tmp_path: Path, command: str) -> None:
    (tmp_path / "a.log").write_text(CANDUMP, encoding="utf-8")
    told = run("diag_service", *(word.format(os.fsdecode(ODD)) for word in command.split()), cwd=tmp_path)
    assert told.status in {2, 3, 4}, told
    assert told.err.count("\n") == 1
    assert told.err.startswith("diag-service: error: ")


def test_the_emulator_writes_under_such_names(odd: Path) -> None:
    log, truth = odd / odd_name("-1.log"), odd / odd_name(".jsonl")
    told = run("ecu_emulator", "record", log, "--truth", truth, "--cycles", "1", "--json", cwd=odd)
    assert told.status == 0
    assert strict(told.out)["file"] == f"{odd_text(odd)}-1.log"
    assert (log.stat().st_size > 0, truth.stat().st_size > 0) == (True, True)
    for words in (["record", log, "--scenario", odd_name(".toml")], ["record", odd_name(".txt")]):
        told = run("ecu_emulator", *words, cwd=odd)
        assert (told.status in {2, 4}, told.err.count("\n")) == (True, 1)


def test_the_backend_keeps_its_database_under_such_a_name(odd: Path) -> None:
    database = f"sqlite:///{odd / odd_name('.sqlite')}"
    for words in (["migrate"], ["table"], ["seen", "--json"], ["hash"]):
        assert run("fleet_backend", *words, "--database", database, cwd=odd).status == 0
    assert (odd / odd_name(".sqlite")).stat().st_size > 0
    for words in (
        ["fill", "car", odd_name("")],
        ["trend", odd_name(""), "1"],
        ["alarms", "--acknowledge", odd_name("")],
    ):
        told = run("fleet_backend", *words, "--database", database, cwd=odd)
        assert (told.status in {2, 5}, told.err.count("\n")) == (True, 1), told
    told = run("fleet_backend", "table", "--database", f"{database}.none", cwd=odd)
    assert (told.status, told.err.count("\n")) == (4, 1)
