"""``inspect``, ``signals`` and ``decode``, from their words to what they print and write."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from canlog.column_files import TableFormat
from canlog.errors import DefinitionError, SourceError
from canlog.tables.decoding import Plan, TableShape, decode_logs
from dbc.contract import DBC_PATH, load_contract
from diag_service.commands import decode, inspect
from diag_service.commands.arguments import COMMAND_LINE
from diag_service.diagnosis.columns import Signal
from diag_service.errors import ConfigError
from diag_service.mapping.profile import load_profile
from diag_service.mapping.tiers import tier_of
from diag_service.service.stopping import Controls

FRAME_COUNT = 1000


def execute(*words: str | Path) -> None:
    """Run a command in this process."""
    options = COMMAND_LINE.parse([str(word) for word in words])
    functions = {"decode": decode.execute, "inspect": inspect.execute, "signals": inspect.propose}
    functions[options.command](options, Controls())


@pytest.fixture
def short_log(drive_log: Path, tmp_path: Path) -> Path:
    """Return the first frames of a drive."""
    path = tmp_path / "short.log"
    path.write_bytes(b"".join(drive_log.read_bytes().splitlines(keepends=True)[:FRAME_COUNT]))
    return path


def test_inspect_tells_what_is_on_the_bus_and_what_is_wrong(
    short_log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = short_log.read_text(encoding="ascii").splitlines()
    spoilt = lines[500][:-1] + ("0" if lines[500][-1] != "0" else "1")
    short_log.write_text("\n".join([*lines[:500], spoilt, "what is this", *lines[501:]]) + "\n", encoding="ascii")
    execute("inspect", short_log)
    out = capsys.readouterr().out
    assert f"candump, {FRAME_COUNT} frames, 10 ids" in out
    assert "1 pieces of the log are not frames (1 malformed), the first: line 502" in out
    assert "no jump of time" in out
    assert f"end-to-end protection: {FRAME_COUNT - 1} good frames of 10 messages, 1 messages with errors" in out
    assert "1 bad crc, 0 missing" in out
    execute("inspect", short_log, "--json", "-b", "250000")
    record = json.loads(capsys.readouterr().out)
    assert record["frames"] == FRAME_COUNT
    assert record["unreadable"] == {"malformed": 1}
    rates = {one["message"]: one["rate_hz"] for one in record["ids"]}
    assert rates["TCU_Pressures"] == pytest.approx(100.0, rel=0.01)
    assert rates["BRK_WheelSpeeds"] == pytest.approx(50.0, rel=0.01)
    assert 0.2 < record["bus_load_ratio"] < 0.4  # 621 frames a second


def test_signals_proposes_a_profile_that_works(
    drive_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    execute("signals", drive_log)
    out = capsys.readouterr().out
    assert "# As it stands it reaches tier 1 (friction)." in out
    assert "# TCU_Pressures (0xb1): " in out
    profile = tmp_path / "car.toml"
    profile.write_text(out, encoding="utf-8")
    proposed, ours = load_profile(profile).sources, load_profile().sources
    assert tier_of(proposed.keys()) == 1
    assert proposed == {signal: ours[signal] for signal in proposed}  # each line is the right one
    assert Signal.CLUTCH_TORQUE not in proposed


def test_row_groups_are_small_whatever_the_log(short_log: Path, tmp_path: Path) -> None:
    plan = replace(Plan.of(load_contract().messages, TableShape.WIDE), max_frames=150)
    decode_logs([short_log], plan, tmp_path / "out.parquet", TableFormat.PARQUET)
    file = pq.ParquetFile(tmp_path / "out.parquet")
    assert file.metadata.num_row_groups > 5
    assert np.all(np.diff(file.read().column("time").to_numpy().astype(np.int64)) >= 0)


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        (("decode", "{tmp}/none.log", "-o", "{tmp}/out.parquet"), SourceError, "none.log"),
        (("inspect", "{log}", "-b", "0"), ConfigError, "bit rate must be > 0"),
        (("inspect", "{tmp}/none.log"), SourceError, "none.log"),
        (("signals", "{log}", "--dbc", "{log}"), DefinitionError, "short.log"),
    ],
)
def test_what_cannot_be_done_is_told(
    short_log: Path, tmp_path: Path, arguments: tuple[str, ...], error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=re.escape(text)):
        execute(*(argument.format(log=short_log, tmp=tmp_path) for argument in arguments))


def test_what_reads_mf4_loads_nothing_that_is_not_needed(drive_log: Path, tmp_path: Path) -> None:
    log = tmp_path / "drive.mf4"
    subprocess.run([sys.executable, "-m", "can.logconvert", drive_log, log], check=True, capture_output=True)
    program = f"""
import sys
from diag_service.cli import main
status = main(["decode", {str(log)!r}, "--dbc", {str(DBC_PATH)!r}, "-o", {str(tmp_path / "drive")!r}])
print(status, [name for name in ("can", "polars.dataframe", "diag_service.diagnosis") if sys.modules.get(name)])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "0 []"
    assert list((tmp_path / "drive").glob("*.parquet"))
