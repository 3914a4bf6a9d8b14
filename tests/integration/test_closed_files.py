"""What another user keeps to himself is named in one line, with the status of its kind, by every command that opens it.

The program is run by a user whose rights are those of any other, also where the tests run as root.
"""

from contextlib import ExitStack
from pathlib import Path

import pytest

from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from tests.support.histories import fill_store, history
from tests.support.in_turn import Left, in_turn
from tests.support.strangers import WRAPPER, given_away

LOG = "(1.000000) can0 123#00\n" * 4
DATABASE = 'VERSION ""\nBU_: A\nBO_ 256 Engine: 2 A\n SG_ Speed : 0|16@1+ (0.25,0) [0|0] "rpm" A\n'
OPEN, CLOSED = "open", "closed"  # folders of the same content

# By the exit status: commands that read what is closed. {} is its folder.
READING = {
    ("diag-service", 2): (
        *(f"{command} {option} {{}}/car.toml"
          for command in ("analyze open/drive.log", "run -i virtual -c nothing", "config check -i virtual -c nothing")
          for option in ("--dbc", "--profile", "--calibration", "--vehicle-file", "--config")),
        "analyze open/drive.log open/second.log --dbc {}/car.dbc",
        "inspect open/drive.log --dbc {}/car.dbc",
        "decode open/drive.log --dbc {}/car.dbc -o made",
        "signals open/drive.log --dbc {}/car.dbc",
        "history open/car.sqlite --peers {}/peers.json",
        "history open/car.sqlite --calibration {}/car.toml",
        "config check -i virtual -c nothing --broker mqtts://127.0.0.1 --password-file {}/password",
        *(f"{command} --broker mqtts://127.0.0.1 {files}"
          for command in ("run -i virtual -c nothing", "analyze open/drive.log", "config check -i virtual -c nothing")
          for files in ("--ca {}/car.crt", "--cert {0}/car.crt --key {0}/car.key")),
        "dtc -i virtual -c nothing --description {}/car.toml",
        "try -i virtual -c nothing --profile {}/car.toml",
    ),
    ("diag-service", 3): (
        "analyze {}/drive.log",
        "analyze open/drive.log {}/second.log",
        "analyze {}/logs",
        "analyze {}/logs -o made.csv",
        "report {}/drive.log -o made.html",
        "report {}/car.sqlite -o made.html",
        "inspect {}/drive.log",
        "inspect {}/logs",
        "signals {}/drive.log --dbc open/car.dbc",
        "decode {}/drive.log --dbc open/car.dbc -o made",
        "decode {}/logs --dbc open/car.dbc -o made",
        "calibrate {}/drive.log -o made.toml",
        "predict {}/drive.log",
        "learn {}/drive.log -o made.toml",
    ),
    ("diag-service", 4): (
        "history {}/car.sqlite",
        "show {}/car.sqlite 1",
        "fluid-changed {}/car.sqlite",
        "fluid-changed {}/car.sqlite --undo",
        "analyze open/drive.log --store {}/car.sqlite",
        "run -i virtual -c nothing --store {}/car.sqlite",
        "analyze {}/logs --lake made",
        "lake check {}/logs",
        "decode open/drive.log --dbc open/car.dbc -o {}/logs",
    ),
    ("ecu-emulator", 2): (
        "record made.log --scenario {}/car.toml",
        "run -i virtual -c nothing --scenario {}/car.toml",
    ),
    ("fleet-backend", 2): (
        "serve --listen 127.0.0.1:0 --database sqlite:///open/fleet.sqlite --access {}/car.toml",
        "ingest --database sqlite:///open/fleet.sqlite --broker mqtts://127.0.0.1 --ca {}/car.crt",
        "peers --database sqlite:///open/fleet.sqlite --write {}/peers.json",
        "watch --once --database sqlite:///open/fleet.sqlite --notify {}/password",
    ),
    ("fleet-backend", 4): tuple(
        f"{command} --database sqlite:///{{}}/fleet.sqlite"
        for command in ("table", "hash", "alarms", "seen", "quarantine", "peers", "codes", "trend car1 1",
                        "forget car1", "fill car1 fluid", "retain --months 3", "serve --listen 127.0.0.1:0",
                        "watch --once")
    ),
}  # fmt: skip
# And those that write into a folder that is closed; a new file, or one that is there already.
WRITING = {
    ("diag-service", 2): (
        "analyze open/drive.log -o {}/made.csv",
        "analyze open/logs -o {}/made.csv",
        "report open/car.sqlite -o {}/made.html",
        "decode open/drive.log --dbc open/car.dbc -o {}/made.csv",
        "calibrate open/drive.log -o {}/made.toml",
        "learn open/drive.log -o {}/made.toml",
        "report open/car.sqlite --force -o {}/made.html",
    ),
    ("ecu-emulator", 2): (
        "record {}/made.log",
        "record {}/made.log --force",
        "record made.log --truth {}/made.jsonl",
        "dbc -o {}/made.dbc",
        "run -i virtual -c nothing --truth {}/made.jsonl",
        "run -i virtual -c nothing --control {}/made.sock",
    ),
    ("ecu-emulator", 4): ("control {}/made.sock trip end",),
    ("fleet-backend", 2): (
        "migrate --database sqlite:///{}/made.sqlite",
        "peers --database sqlite:///open/fleet.sqlite --write {}/made.json",
    ),
}


def filled(folder: Path) -> Path:
    """Return a folder with something of every kind that commands open."""
    (folder / "logs").mkdir(parents=True)
    for name in ("drive.log", "second.log", "logs/drive.log"):
        (folder / name).write_text(LOG, encoding="ascii")
    for name in ("car.toml", "car.crt", "car.key", "peers.json", "password"):
        (folder / name).touch(0o600)
    (folder / "car.dbc").write_text(DATABASE, encoding="ascii")
    fill_store(folder / "car.sqlite", history(3))
    engine = open_database(f"sqlite:///{folder}/fleet.sqlite")
    migrate(engine)
    engine.dispose()
    return folder


@pytest.fixture(name="home")
def _home(tmp_path: Path) -> Path:
    """Return a folder with two that hold the same."""
    for name in (OPEN, CLOSED):
        filled(tmp_path / name)
    return tmp_path


def assert_told(asked: dict[tuple[str, int], tuple[str, ...]], home: Path) -> None:
    commands = [
        (program, status, command.format(CLOSED).split())
        for (program, status), lines in asked.items()
        for command in lines
    ]
    left = in_turn([(program, *words) for program, _, words in commands], home, WRAPPER)
    wrong = [one for one, (program, status, _) in zip(left, commands, strict=True) if not is_told(one, program, status)]
    assert wrong == []
    assert not list(home.glob("made*"))


def is_told(left: Left, program: str, status: int) -> bool:
    """Return whether the one line says that something in the closed folder may not be opened."""
    (*others, line) = [line for line in left.err.splitlines() if "first start: compiling" not in line] or [""]
    words = (f"{program}: error: ", f"{CLOSED}/", "Permission denied")
    return (left.status, others) == (status, []) and all(word in line for word in words) and "Errno" not in line


def test_a_file_that_is_closed_is_named(home: Path) -> None:
    with ExitStack() as stack:
        for path in (home / CLOSED).iterdir():
            stack.enter_context(given_away(path, 0o700 if path.is_dir() else 0o600))
        assert_told(READING, home)


def test_a_folder_that_is_closed_is_named(home: Path) -> None:
    with given_away(home / CLOSED, 0o700):
        assert_told(READING, home)
        assert_told(WRITING, home)
