"""A car that is asked while it is diagnosed, as processes on a real vcan: a candump of it says the same afterwards."""

import signal
from pathlib import Path

import pytest

from tests.e2e.test_vcan_drive import emulator, listening, of_the_drive
from tests.plugins.asked_services import SentByUs
from tests.support.bus_end import candump
from tests.support.in_process import ended as run

SHIFT_COUNT = 4

pytestmark = [pytest.mark.vcan, pytest.mark.asks]


def test_a_candump_of_a_car_that_is_asked_says_the_same_to_the_bit(
    vcan: str, tmp_path: Path, sent_by_us: SentByUs
) -> None:
    log, words = tmp_path / "bus.log", ("--profile", "dct_asked")
    with (
        candump(vcan, log),
        listening(tmp_path / "service", vcan, *words, "--active") as live,
    ):
        with emulator(
            tmp_path / "car", vcan, "--scenario", "case2", "--answers-like", "vw_dsg", "--cycles", "1"
        ) as car:
            live.wait_for(lambda: len(live.out.splitlines()) >= SHIFT_COUNT)
            car.send(signal.SIGTERM)
            assert car.wait().status == 0
        live.send(signal.SIGTERM)
        ended = live.wait()
    replayed = run("analyze", log, *words, "--json")
    assert (ended.status, replayed.status) == (0, 0), (ended.err, replayed.err)
    assert len(ended.shifts) >= SHIFT_COUNT
    assert [of_the_drive(one) for one in replayed.shifts] == [of_the_drive(one) for one in ended.shifts]
    assert replayed.summary["frames"] == ended.summary["frames"]
    sent_by_us.note_log(log)
    assert sent_by_us.services[0x22] > 50
