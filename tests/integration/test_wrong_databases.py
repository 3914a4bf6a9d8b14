"""A database of another bus, a silent bus and times that are too coarse are called what they are."""

import json
import re
from pathlib import Path
from types import SimpleNamespace

import pytest

from canlog.database.addressing import why_wrong
from canlog.logs import read_log
from canlog.logs.log_counts import WHOLE_SECONDS
from clutch_results.records import ShiftStatistics
from dbc.contract import DBC_PATH
from diag_service.diagnosis.frame_counts import FrameCounts
from diag_service.diagnosis.summary import Summary, capability_line
from tests.support.in_process import ended as run
from tests.support.service import Ended

FRAMES = 1_500
IDS = range(0x300, 0x332)

OTHER_BUS = """VERSION ""
BU_: A
""" + "".join(
    f'BO_ {can_id} M{can_id}: 8 A\n SG_ EngineSpeed{can_id} : 0|16@1+ (0.25,0) [0|0] "rpm" A\n'
    for can_id in (*IDS[:2], *range(0x400, 0x410))
)


@pytest.fixture
def car(tmp_path: Path) -> SimpleNamespace:
    """Return a log of fifty identifiers, and a database that by chance has two of them."""
    log, dbc = tmp_path / "car.log", tmp_path / "other.dbc"
    lines = (f"({n * 0.002:.6f}) can0 {IDS[n % len(IDS)]:03X}#{n:016X}" for n in range(FRAMES))
    log.write_text("\n".join(lines) + "\n", encoding="ascii")
    dbc.write_text(OTHER_BUS, encoding="ascii")
    return SimpleNamespace(log=log, dbc=dbc, folder=tmp_path)


def said(ended: Ended) -> str:
    return " ".join((ended.out + ended.err).split())


@pytest.mark.parametrize("command", ["signals", "inspect", "decode"])
def test_a_database_of_another_bus_is_called_probably_wrong(car: SimpleNamespace, command: str) -> None:
    words = ("-o", car.folder / "car.csv") if command == "decode" else ()
    ended = run(command, car.log, "--dbc", car.dbc, *words)
    assert ended.status == 0, ended.err
    text = (
        "probably the wrong database: 2 of 50 identifiers of the log are in it, and 2 of its 18 messages are in the log"
    )
    assert text in said(ended).replace("# ", "")


def test_an_analysis_that_uses_next_to_nothing_says_so(car: SimpleNamespace) -> None:
    profile = car.folder / "car.toml"
    profile.write_text('[signals]\nengine_speed_rad_s = { message = "M768", signal = "EngineSpeed768" }\n', "ascii")
    lines = car.log.read_text("ascii").splitlines()
    few = [line for number, line in enumerate(lines) if " 300#" not in line or number % 1_000 == 0]
    car.log.write_text("\n".join(few) + "\n", encoding="ascii")
    ended = run("analyze", car.log, "--dbc", car.dbc, "--profile", profile)
    assert "2 of 1472 frames are of messages of the profile" in said(ended), said(ended)
    assert "probably wrong" in said(ended)


def test_the_database_of_the_emulated_vehicle_is_not_taken_in_silence(car: SimpleNamespace) -> None:
    ended = run("decode", car.log, "-o", car.folder / "car.csv")
    assert ended.status == 2
    assert "used without --dbc: name that of this bus with --dbc FILE" in said(ended)


def test_in_a_folder_it_is_not_taken_in_silence_either(car: SimpleNamespace, drive_log: Path) -> None:
    logs = car.folder / "logs"
    logs.mkdir()
    (logs / "drive.log").write_bytes(drive_log.read_bytes())
    car.log.rename(logs / "car.log")
    ended = run("decode", logs, "--jobs", "1", "-o", car.folder / "refused")
    assert ended.status == 2, said(ended)
    assert "car.log: the log is not of the emulated vehicle, whose database is used without --dbc" in said(ended)
    assert run("decode", logs, "--jobs", "1", "--dbc", car.dbc, "-o", car.folder / "read").status == 0


def test_friction_is_refused_shift_by_shift_where_times_are_whole_seconds(drive_log: Path, tmp_path: Path) -> None:
    coarse = tmp_path / "coarse.log"
    coarse.write_text(re.sub(r"^\((\d+)\.\d+\)", r"(\1.000000)", drive_log.read_text("ascii"), flags=re.MULTILINE))
    analysed = run("analyze", coarse, "--json")
    assert analysed.status == 0, analysed.err
    *shifts, summary = map(json.loads, analysed.out.splitlines())
    assert shifts
    assert {(one["status"], *one["reasons"]) for one in shifts} == {("rejected", "times_in_whole_seconds")}
    assert {one["friction"] for one in shifts} == {None}
    assert summary["shifts"]["by_reason"] == {"times_in_whole_seconds": len(shifts)}
    assert "[times in whole seconds]" in said(run("analyze", coarse))
    predicted = said(run("predict", coarse))
    assert "predicted from others" not in predicted
    changes = [one for one in shifts if one["from_gear"] != one["to_gear"] and min(one["from_gear"], one["to_gear"])]
    assert predicted.count("not used: times in whole seconds") == len(changes) == 3
    assert WHOLE_SECONDS in said(run("signals", coarse, "--dbc", DBC_PATH)).replace("# ", "")


def test_a_database_that_knows_most_of_a_bus_or_is_there_for_the_most_part_is_not_doubted() -> None:
    assert why_wrong(known=40, ids=50, came=40, messages=900) == ""
    assert why_wrong(known=1, ids=180, came=1, messages=1) == ""
    assert why_wrong(known=0, ids=0, came=0, messages=10) == ""


def test_a_silent_bus_is_told_as_silent() -> None:
    summary = Summary(vehicle="v", frames=FrameCounts(), shifts=ShiftStatistics(), unpublished_count=None)
    assert capability_line(summary) == "no frame came: check the channel, the bit rate, and whether the ignition is on"


@pytest.mark.parametrize(("digits", "step_s", "is_told"), [(0, 0.002, True), (6, 0.002, False), (0, 1.0, False)])
def test_times_of_whole_seconds_are_told(tmp_path: Path, digits: int, step_s: float, *, is_told: bool) -> None:
    log = tmp_path / "coarse.log"
    times_s = [1_700_000_000 + n * step_s for n in range(FRAMES)]
    lines = (f"({int(t) if digits == 0 else t:.6f}) can0 123#{n:016X}" for n, t in enumerate(times_s))
    log.write_text("\n".join(lines) + "\n", encoding="ascii")
    reader = read_log(log)
    assert sum(len(batch) for batch in reader) == FRAMES
    assert (WHOLE_SECONDS in reader.counts.notes) is is_told
