"""A car that is asked while it is diagnosed, as processes on a real vcan: a candump of it says the same afterwards."""

import signal
from importlib.resources import files
from pathlib import Path

import pytest

from tests.e2e.test_vcan_drive import emulator, listening, of_the_drive
from tests.plugins.asked_services import SentByUs
from tests.support.bus_end import candump
from tests.support.in_process import ended as run

SHIFT_COUNT = 4
RATIOS = "[44.59, 27.47, 18.54, 13.66, 10.72, 9.014]"  # engine over road speed [rad/m], as the emulated car has them

pytestmark = [pytest.mark.vcan, pytest.mark.asks]


def known_gears(folder: Path) -> Path:
    """Return the description of the car, which a car needs that tells no gear."""
    path = folder / "car.toml"
    text = files("clutch_model").joinpath("calibrations/nominal.toml").read_text("utf-8")
    path.write_text(f'{text}\n[gears]\nover = "vehicle_speed_m_s"\nratios = {RATIOS}\n', encoding="utf-8")
    return path


@pytest.mark.parametrize(("like", "profile"), [("vw_dsg", "dct_asked"), ("bmw_dkg", "bmw_dkg")])
def test_a_candump_of_a_car_that_is_asked_says_the_same_to_the_bit(
    vcan: str, tmp_path: Path, sent_by_us: SentByUs, like: str, profile: str
) -> None:
    log, words = tmp_path / "bus.log", ["--profile", profile]
    words += ["--vehicle-file", str(known_gears(tmp_path))] if like == "bmw_dkg" else []
    with candump(vcan, log), listening(tmp_path / "service", vcan, *words, "--active") as live:
        with emulator(tmp_path / "car", vcan, "--scenario", "case2", "--answers-like", like, "--cycles", "5") as car:
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
