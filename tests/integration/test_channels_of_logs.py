"""Logs of one drive number their channels each in its own way; what contributes nothing is said."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from clutch_model.calibration import nominal_calibration
from dbc.contract import load_contract
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.frame_counts import FrameCounts
from diag_service.diagnosis.summary import Contributions
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.drive import DriveFrames, open_drive
from diag_service.service.recorded import events
from diag_service.service.stages import Stages
from diag_service.stopping import Trigger
from tests.support.in_process import ended

DATABASE = load_contract()
GATEWAY = b"0B3"  # TCU_Shift
ENGINE = (b"0A0", b"0A8")  # what the engine sends, by identifier


@dataclass(frozen=True, slots=True, kw_only=True)
class Followed:
    """What became of a drive of some logs."""

    shifts: Sequence[Event]
    counts: FrameCounts
    rejected: dict[str, int]
    contributions: Contributions


def followed(paths: Sequence[Path], channel: int | None = None) -> Followed:
    decoder = Decoder(DATABASE, replace(load_profile(), channel=channel))
    calibration = nominal_calibration()
    stages = Stages(decoder, calibration)
    with open_drive(paths) as logs:
        frames = DriveFrames(logs, stages.decoder.sources)
        shifts = list(events(frames, stages, Trigger()))
    return Followed(
        shifts=shifts,
        counts=decoder.counts,
        rejected=dict(stages.decoder.counts.rejected),
        contributions=frames.contributions(channel),
    )


def can_id(line: bytes) -> bytes:
    return line.split()[2].split(b"#")[0]


def on(channel: int, lines: Sequence[bytes]) -> list[bytes]:
    """Return lines on another channel, a little later as behind a gateway."""
    return [line.replace(b"can0", b"can%d" % channel, 1) for line in lines]


def written(path: Path, lines: Sequence[bytes]) -> Path:
    path.write_bytes(b"".join(lines))
    return path


@pytest.fixture(name="lines", scope="module")
def _lines(drive_log: Path) -> list[bytes]:
    return drive_log.read_bytes().splitlines(keepends=True)


@pytest.fixture(name="halves", scope="module")
def _halves(lines: list[bytes], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return a drive in two logs, one after the other, whose formats number the same bus 0 and 1."""
    folder, half = tmp_path_factory.mktemp("halves"), len(lines) // 2
    return [written(folder / "monday.log", lines[:half]), written(folder / "tuesday.log", on(1, lines[half:]))]


@pytest.fixture(name="buses", scope="module", params=[0, 1], ids=["numbered alike", "numbered apart"])
def _buses(request: pytest.FixtureRequest, lines: list[bytes], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return two buses recorded at the same time; a gateway repeats one message of the second on the first."""
    folder, number = tmp_path_factory.mktemp("buses"), int(request.param)
    return [
        written(folder / "engine.log", [line for line in lines if can_id(line) in {*ENGINE, GATEWAY}]),
        written(folder / "gearbox.log", on(number, [line for line in lines if can_id(line) not in ENGINE])),
    ]


def test_buses_recorded_at_the_same_time_both_contribute(buses: list[Path], lines: list[bytes]) -> None:
    found = followed(buses)
    twice = sum(can_id(line) == GATEWAY for line in lines)
    assert found.rejected == {"other_channel": twice}
    assert found.counts.decoded + found.counts.ignored == len(lines)
    assert found.counts.missing == 0
    assert len(found.shifts) == 3
    first, second = found.contributions.logs
    assert (first.rejected.get("other_channel", 0) + second.rejected.get("other_channel", 0)) == twice
    assert first.decoded
    assert second.decoded
    assert not found.contributions.idle


def test_a_message_on_two_buses_is_not_mixed(lines: list[bytes], tmp_path: Path) -> None:
    """The other bus says something else under the same identifiers: not one value of it may come through."""
    mine = [line for line in lines if can_id(line) == GATEWAY]
    other = [
        line.replace(b"can0", b"can7").replace(b"B3#", b"B3#FFFF")[: line.index(b"#") + 17] + b"\n" for line in mine
    ]
    alone = followed([written(tmp_path / "alone.log", lines)])
    both = followed([written(tmp_path / "bus.log", lines), written(tmp_path / "other.log", other)])
    assert both.rejected == {"other_channel": len(mine)} | alone.rejected
    assert both.counts.decoded == alone.counts.decoded
    assert [(one.start_ns, one.end_ns) for one in both.shifts] == [(one.start_ns, one.end_ns) for one in alone.shifts]


def test_the_summary_tells_the_share_of_each_log(halves: list[Path]) -> None:
    told = ended("analyze", *halves, "--json", "--strict")
    assert told.status == 0, told.err
    assert "contributed nothing" not in told.err
    logs = told.summary["logs"]
    assert [(log["path"], log["followed_channels"]) for log in logs] == [(str(halves[0]), [0]), (str(halves[1]), [1])]
    frames = told.summary["frames"]
    for key, total in (("frames", frames["on_bus"]), ("decoded", frames["decoded"]), ("ignored", frames["ignored"])):
        assert sum(log[key] for log in logs) == total
    assert told.summary["idle"] == []
