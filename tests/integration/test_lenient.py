"""A database with an item that cannot be right: every command names it, and leaves it out if it is told to."""

from pathlib import Path

import pytest

from dbc.contract import DBC_PATH
from diag_service.cli import main
from diag_service.commands.arguments import COMMAND_LINE

ITEM = 'VAL_ 300 Missing 0 "off" 1 "on";'
COMMANDS = {
    "inspect": ("inspect", "{log}"),
    "signals": ("signals", "{log}"),
    "decode": ("decode", "{log}", "-o", "{tmp}/drive.parquet"),
    "analyze": ("analyze", "{log}"),
    "folder": ("analyze", "{folder}", "-o", "{tmp}/drives.jsonl"),
    "config": ("config", "check"),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_wrong_item_stops_a_command_or_is_left_out(
    command: str, tmp_path: Path, drive_log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = DBC_PATH.read_text(encoding="utf-8")
    database = tmp_path / "car.dbc"
    database.write_text(f"{text}{ITEM}\n", encoding="utf-8")
    folder = tmp_path / "drives"
    folder.mkdir()
    (folder / "drive.log").symlink_to(drive_log)
    words = [word.format(log=drive_log, tmp=tmp_path, folder=folder) for word in COMMANDS[command]]
    place = f"{database}: line {text.count(chr(10)) + 1}: {ITEM}: there is no message 300"
    assert main([*words, "--dbc", str(database)]) == 2
    assert place.replace(": line", " does not load strictly: line") in capsys.readouterr().err
    assert main([*words, "--dbc", str(database), "--lenient"]) == 0
    assert f"diag-service: warning: {place} (left out)\n" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["run", "monitor", "calibrate", "analyze", "inspect", "signals", "decode"])
def test_every_command_with_a_database_may_be_told(command: str) -> None:
    words = {"calibrate": ["a.log", "-o", "a.toml"], "decode": ["a.log", "-o", "a.parquet"], "run": [], "monitor": []}
    options = COMMAND_LINE.parse([command, *words.get(command, ["a.log"]), "--dbc", "a.dbc", "--lenient"])
    assert options.lenient is True
