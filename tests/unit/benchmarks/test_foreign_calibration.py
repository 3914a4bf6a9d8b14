"""The study of foreign calibrations: its blocks, its vehicles, its table."""

from benchmarks.foreign_calibration import NO_ROUTINE, Row, blocks_of, report, scattered


def row(calibration: str, *, is_lost: bool, off_std: float) -> Row:
    return Row(
        vehicle="drawn",
        calibration=calibration,
        seed=1,
        is_lost_ever=True,
        is_lost_last=is_lost,
        off_std=off_std,
    )


def test_every_vehicle_is_in_one_block() -> None:
    blocks = blocks_of(100, 14)
    assert [len(block) for block in blocks] == [6, 6, 2]
    assert [seed for block in blocks for seed in block] == list(range(100, 114))


def test_drives_of_a_vehicle_share_the_car_alone() -> None:
    first, later = (scattered(7, drive, NO_ROUTINE) for drive in (0, 1))
    assert first.seed_of_vehicle == later.seed_of_vehicle == 7
    assert first.seed_of_drive != later.seed_of_drive
    assert scattered(8, 0, NO_ROUTINE).fluid != first.fluid


def test_only_a_verdict_that_was_given_is_wrong() -> None:
    rows = [
        row("another vehicle's", is_lost=True, off_std=9.0),
        row("another vehicle's", is_lost=False, off_std=9.0),
        row("another vehicle's", is_lost=False, off_std=1.0),
        row("its own", is_lost=False, off_std=1.0),
    ]
    assert list(report(rows))[2:] == [
        "| drawn | another vehicle's | 3 | 3 | 1 | 1 |",
        "| drawn | its own | 1 | 1 | 0 | 0 |",
    ]
