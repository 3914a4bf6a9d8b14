"""A fluid that ages: emulator and service at the two ends of a pipe, which goes as fast as both reckon."""

import asyncio
import json
import os
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from rich.table import Table
from rich.text import Text

from clutch_results.records import SHIFT_SCHEMA, shift_from
from clutchdiag_io.people import SHORT_PLUS_MINUS, plus_minus
from demo.ageing_picture import Point, draw, points_of
from demo.outcome import CONDITION_STYLE, plain_table
from demo.programs import EMULATOR, HURRY_S, SERVICE, program
from diag_service.delivery.console import condition_words
from ecu_emulator.truth import read_truth

CLUTCH: Final = 2
SCENARIO: Final = "ageing"
TRUTH, PICTURE = "truth.jsonl", "ageing.svg"
TAKES_S: Final = 25  # on two idle cores, beside a drive on a bus
EXPLANATION: Final = "a fluid ages within 17 minutes of driving, through a pipe, faster than real time"
EVERY: Final = 15  # shifts of the clutch between rows
COURSE: Final = ("good", "watch", "change fluid")


async def let_age(folder: Path) -> list[Point]:
    """Let a fluid age, with a folder for it alone; return what the service says of it beside the truth."""
    reading, writing = os.pipe()
    try:
        driving = program(
            EMULATOR, "record", "-", "--scenario", SCENARIO, "--truth", folder / TRUTH, "--force",
            folder=folder, stdout=writing, stop_s=HURRY_S,
        )  # fmt: skip
        listening = program(SERVICE, "analyze", "-", "--json", folder=folder, stdin=reading, stop_s=HURRY_S)
        async with listening as service, driving as emulator:
            for end in (reading, writing):  # each of the two ends when the other has let go
                os.close(end)
            reading = writing = -1
            await emulator.wait()
            await service.wait()
            records = [json.loads(line) for line in service.output.splitlines()]
    finally:
        for end in (reading, writing):
            if end >= 0:
                os.close(end)
    shifts = [shift_from(record) for record in records if record["schema"] == SHIFT_SCHEMA]
    return points_of(shifts, read_truth(folder / TRUTH))


def ageing_table(points: Sequence[Point]) -> Table:
    """Return the running estimate beside the truth, every few shifts and wherever the verdict has changed."""
    table = plain_table(
        f"Clutch {CLUTCH} while its fluid ages: the running estimate beside the truth",
        (
            "shift",
            f"mu_C {SHORT_PLUS_MINUS}",
            "truth",
            f"mu_S {SHORT_PLUS_MINUS}",
            "truth",
            "P(slope<0)",
            "verdict",
        ),
    )
    number = 0
    for condition, same in groupby(points, key=lambda point: point.condition):
        for place, point in enumerate(same):
            number += 1
            if place and number % EVERY and number != len(points):
                continue
            friction, words = point.running, condition_words(condition)
            table.add_row(
                str(number),
                plus_minus(friction.mu_c, friction.std_mu_c), f"{point.truth.mu_c:.4f}",
                plus_minus(friction.mu_s, friction.std_mu_s), f"{point.truth.mu_s:.4f}",
                f"{friction.probability_negative_slope:.3f}", Text(words, CONDITION_STYLE[words]),
            )  # fmt: skip
    return table


def course_complaints(points: Sequence[Point]) -> list[str]:
    """Return what is wrong with the verdicts: they must be good, then watch, then change fluid until the end."""
    heard = [condition_words(point.condition) for point in points]
    first = [heard.index(words) for words in COURSE if words in heard]
    if len(first) < len(COURSE) or first != sorted(first) or heard[-1] != COURSE[-1]:
        course = ", ".join(words for words, _ in groupby(heard))
        return [f"of the ageing fluid the service said {course or 'nothing'}, not {', '.join(COURSE)}"]
    return []


def main() -> None:
    """Draw the picture of the README."""
    with TemporaryDirectory() as folder:
        points = asyncio.run(let_age(Path(folder)))
    (Path(__file__).parents[1] / "docs" / PICTURE).write_text(draw(points), encoding="utf-8")


if __name__ == "__main__":
    main()
