"""``inspect``, ``signals`` and ``decode``, from their words to what they print and write."""

import json
from pathlib import Path

import pytest

from diag_service.diagnosis.columns import Signal
from diag_service.mapping.mapped_messages import tier_of
from diag_service.mapping.profile import load_profile
from tests.support.in_process import command

FRAME_COUNT = 1000


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
    command("inspect", short_log)
    out = capsys.readouterr().out
    assert f"candump, {FRAME_COUNT} frames, 10 ids" in out
    assert "1 pieces of the log are not frames (1 malformed), the first: line 502" in out
    assert "no jump of time" in out
    assert f"end-to-end protection: {FRAME_COUNT - 1} good frames of 10 messages, 1 messages with errors" in out
    assert "1 bad crc, 0 missing" in out
    command("inspect", short_log, "--json", "-b", "250000")
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
    command("signals", drive_log)
    out = capsys.readouterr().out
    assert "# As it stands it reaches tier 1 (friction)." in out
    assert "# TCU_Pressures (0xb1): " in out
    profile = tmp_path / "car.toml"
    profile.write_text(out, encoding="utf-8")
    proposed, ours = load_profile(profile).sources, load_profile().sources
    assert tier_of(proposed.keys()) == 1
    assert proposed == {signal: ours[signal] for signal in proposed}  # each line is the right one
    assert Signal.CLUTCH_TORQUE not in proposed
