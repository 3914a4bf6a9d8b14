"""Logs of one drive number their channels each in its own way; what contributes nothing is said."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from clutch_model.calibration import nominal_calibration
from dbc.contract import load_contract
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.contributions import Contributions
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.summary import FrameCounts
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.calibrate_run import find_events
from diag_service.service.drive import DriveFrames, open_drive
from diag_service.service.recorded import events
from diag_service.service.stages import Stages
from diag_service.service.stopping import Trigger
from tests.support.in_process import ended
from tests.support.service import Ended

DATABASE = load_contract()
GATEWAY = b"0B3"  # TCU_Shift
OTHER_ID = b"7F0"  # of no message that is used
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
    stages = Stages(decoder, calibration, Posterior.fresh(calibration), ConditionMemory.fresh())
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
    return [
        written(folder / "monday.log", lines[:half]),
        written(folder / "tuesday.log", on(1, lines[half:])),
    ]


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


def test_a_log_that_ends_frees_its_own_messages_only(lines: list[bytes], tmp_path: Path) -> None:
    """A short log of the gearbox must not make the messages of the long one change their channel."""
    engine = [line for line in lines if can_id(line) in ENGINE]
    rest = [line for line in lines if can_id(line) not in ENGINE]
    doubled = [copy for line in engine for copy in (line, *on(5, [line]))]
    found = followed([
        written(tmp_path / "engine.log", doubled),
        written(tmp_path / "first.log", rest[: len(rest) // 2]),
        written(tmp_path / "last.log", rest[len(rest) // 2 :]),
    ])  # fmt: skip
    assert found.rejected == {"other_channel": len(engine)}
    assert [log.used_channels for log in found.contributions.logs] == [(0,)] * 3
    assert found.contributions.idle == (
        (
            f"channel 5 of {tmp_path / 'engine.log'} contributed nothing: {len(engine)} frames of messages that are "
            "followed elsewhere"
        ),
    )


def test_a_damaged_log_is_warned_of_once(lines: list[bytes], tmp_path: Path) -> None:
    """Damage that changes numbers of channels makes as many channels as there are numbers."""
    strays = [on(100 + number, [line])[0] for number, line in enumerate(lines[1_000:1_100])]
    path = written(tmp_path / "damaged.log", [*lines[:1_000], *strays, *lines[1_100:]])
    (text,) = followed([path]).contributions.idle
    assert text.startswith(f"channel 100 and 99 more of {path} contributed nothing: ")


def test_logs_that_meet_within_one_tick_lose_no_frame(lines: list[bytes], tmp_path: Path) -> None:
    stamp = lines[2_000].split()[0]
    lines = [*lines[:1_990], *(stamp + line[line.index(b" ") :] for line in lines[1_990:2_010]), *lines[2_010:]]
    found = followed([written(tmp_path / "a.log", lines[:2_000]), written(tmp_path / "b.log", on(1, lines[2_000:]))])
    assert "other_channel" not in found.rejected


def test_more_logs_than_there_are_channel_numbers(lines: list[bytes], tmp_path: Path) -> None:
    pieces = [lines[start : start + 20] for start in range(0, 20 * 300, 20)]
    paths = [written(tmp_path / f"{number:03d}.log", on(number % 3, piece)) for number, piece in enumerate(pieces)]
    found = followed(paths)
    assert not found.rejected
    assert sum(log.frames for log in found.contributions.logs) == 20 * 300
    assert all(log.frames == 20 for log in found.contributions.logs)


def test_a_named_channel_that_a_log_lacks_is_said(halves: list[Path]) -> None:
    found = followed(halves, channel=0)
    count = len(halves[1].read_bytes().splitlines())
    (text,) = found.contributions.idle
    assert text == f"{halves[1]} contributed nothing: {count} frames on another channel (1; the profile names 0)"


def test_a_log_of_nothing_that_is_used_is_said(lines: list[bytes], tmp_path: Path) -> None:
    body = [line.split(b"#")[0][:-3] + OTHER_ID + b"#00\n" for line in lines[:50]]
    drive, other = written(tmp_path / "drive.log", lines), written(tmp_path / "body.log", on(1, body))
    assert followed([drive, other]).contributions.idle == (
        f"{other} contributed nothing: 50 frames of messages that are not used",
    )


def test_a_channel_with_its_own_numbers_says_who_is_followed(lines: list[bytes], tmp_path: Path) -> None:
    drive, copy = written(tmp_path / "drive.log", lines), written(tmp_path / "copy.log", on(1, lines[50:-50]))
    assert followed([drive, copy]).contributions.idle == (
        f"{copy} contributed nothing: {len(lines) - 100} frames on another channel (1; the drive follows 0)",
    )


@pytest.fixture(name="analyzed", scope="module", params=["", "folder", "paper"])
def _analyzed(
    request: pytest.FixtureRequest, lines: list[bytes], tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., Ended]:
    """Return how to analyze a log beside one that gives nothing, with options."""
    folder = tmp_path_factory.mktemp("analyzed")
    written(folder / "monday.log", lines)
    written(folder / "tuesday.log", on(1, lines[100:-100]))
    more = {"": (), "folder": ("-o", folder / "out.jsonl", "--force"), "paper": ("--estimator", "paper")}

    def analyze(*options: str) -> Ended:
        logs = (folder / "monday.log", folder / "tuesday.log")
        return ended("analyze", *logs, *more[request.param], "--json", *options)

    return analyze


def test_strict_ends_with_a_status_of_its_own(
    analyzed: Callable[..., Ended], capfd: pytest.CaptureFixture[str]
) -> None:
    plain, strict = analyzed(), analyzed("--strict")
    said = capfd.readouterr().err + plain.err
    assert "warning: " in said
    assert "tuesday.log contributed nothing: " in said
    assert (plain.status, strict.status) == (0, 5), strict.err
    assert "contributed nothing" in strict.err.splitlines()[-1]
    assert len(plain.records) == len(strict.records)


def test_a_calibration_says_which_log_gave_nothing(
    lines: list[bytes], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    logs = [written(tmp_path / "drive.log", lines), written(tmp_path / "copy.log", on(1, lines[50:-50]))]
    with open_drive(logs) as drive:
        found = find_events(drive, Decoder(DATABASE, load_profile()), nominal_calibration(), Trigger())
    assert len(found.shifts) == 3
    assert f"{logs[1]} contributed nothing: " in caplog.text


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
