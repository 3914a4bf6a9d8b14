"""Lines that stand later in a log than their times, and frames of others between those of the drive."""

import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from fleet_contract import JsonObject
from tests.support.in_process import ended

ENGINE = ("0A0", "0A8")  # what the engine sends, by identifier
FOREIGN = "3E9#0011223344556677"  # of no message of the database
SEED = 93
Line = tuple[int, str, str]  # time [us], channel, frame


def lines_of(log: Path) -> list[Line]:
    """Return the lines of a candump log."""
    parted = (line.split() for line in log.read_text(encoding="ascii").splitlines())
    return [(int(at.strip("()").replace(".", "")), channel, frame) for at, channel, frame in parted]


def written(path: Path, lines: Sequence[Line]) -> Path:
    """Write lines as they stand."""
    text = "".join(f"({at // 10**6}.{at % 10**6:06d}) {channel} {frame}\n" for at, channel, frame in lines)
    path.write_text(text, encoding="ascii")
    return path


def on_two_channels(lines: Sequence[Line]) -> list[Line]:
    """Return lines with those of the engine on a second channel, a moment before the next ones of the first."""
    return sorted(
        (at + 996, "can1", frame) if frame[:3] in ENGINE else (at, channel, frame) for at, channel, frame in lines
    )


def standing_at(lines: Sequence[Line], place_us: Sequence[int]) -> list[Line]:
    """Return lines in the order of the places that they are given [us]."""
    order = np.argsort(np.array(place_us), kind="stable")
    return [lines[row] for row in order]


def results_of(log: Path) -> tuple[list[JsonObject], str]:
    """Return the results of a log without its name, and what was said beside them."""
    run = ended("analyze", log, "--json")
    assert run.status == 0, run.err
    records = [json.loads(line) for line in run.out.splitlines()]
    shifts = [record for record in records if record["schema"].startswith("clutchdiag/shift/")]
    return [{key: value for key, value in shift.items() if key != "stream"} for shift in shifts], run.err


@pytest.fixture(scope="module")
def in_order(drive_log: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Line], list[JsonObject]]:
    """Return a drive of two channels in the order of its times, and its results."""
    lines = on_two_channels(lines_of(drive_log))
    log = written(tmp_path_factory.mktemp("order") / "drive.log", lines)
    return lines, results_of(log)[0]


@pytest.mark.parametrize("later_us", [10, 1_000, 20_000, 99_000])
def test_a_second_channel_that_stands_later_in_the_file_changes_no_result(
    later_us: int, in_order: tuple[list[Line], list[JsonObject]], tmp_path: Path
) -> None:
    lines, results = in_order
    assert results
    places = [at + later_us * (channel == "can1") for at, channel, _ in lines]
    of_log, remarks = results_of(written(tmp_path / "drive.log", standing_at(lines, places)))
    assert of_log == results
    told = re.search(r"(\d+) frames stand up to ([\d.]+) ms later than their times", remarks)
    assert told is not None, remarks
    assert 0.0 < float(told[2]) <= later_us / 1e3


def test_lines_that_are_shuffled_within_five_milliseconds_change_no_result(
    in_order: tuple[list[Line], list[JsonObject]], tmp_path: Path
) -> None:
    lines, results = in_order
    moved_us = np.random.default_rng(SEED).integers(0, 5_000, len(lines)).tolist()
    places = [at + moved for (at, *_), moved in zip(lines, moved_us, strict=True)]
    assert results_of(written(tmp_path / "drive.log", standing_at(lines, places)))[0] == results


@pytest.mark.parametrize("early_us", [10, 50_000, 150_000, 20_000_000])
def test_frames_of_others_that_are_early_end_nothing(
    early_us: int, in_order: tuple[list[Line], list[JsonObject]], tmp_path: Path
) -> None:
    lines, results = in_order
    mixed: list[Line] = []
    for number, (at, channel, frame) in enumerate(lines):
        mixed.append((at, channel, frame))
        if number % 100 == 99:
            mixed.append((at - early_us, channel, FOREIGN))
    assert results_of(written(tmp_path / "drive.log", mixed))[0] == results
