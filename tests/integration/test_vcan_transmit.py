"""The emulator's sending end on a real vcan: full buffers, an interface that goes away."""

import threading

import pytest

from ecu_emulator.bus.sender import TransmitReport, open_bus, transmit
from ecu_emulator.errors import BusError
from tests.support.starvation import StarvationWatch, undisturbed
from tests.support.traffic import random_frames
from tests.uml.vcan import ip_link

pytestmark = pytest.mark.vcan


def test_an_interface_switched_off_while_sending_is_one_clear_error(vcan: str) -> None:
    frames = random_frames(2_000)
    threading.Timer(0.3, ip_link, ("set", vcan, "down")).start()
    with open_bus("socketcan", vcan) as bus, pytest.raises(BusError, match="the bus went away after") as caught:
        transmit(bus, [frames], threading.Event())
    assert "\n" not in str(caught.value)


def test_an_interface_that_is_down_says_what_to_do(vcan: str) -> None:
    assert ip_link("set", vcan, "down")
    with pytest.raises(BusError, match=f"it is down .ip link set {vcan} up"):
        open_bus("socketcan", vcan)


def test_an_unknown_interface_says_what_to_do() -> None:
    with pytest.raises(BusError, match=r"no such interface .ip link add vcan99 type vcan"):
        open_bus("socketcan", "vcan99")


def test_the_schedule_is_kept(vcan: str) -> None:
    """Where the machine gives the sender no time, what is left of the claim is that it never runs ahead."""

    def attempt(_: int) -> tuple[TransmitReport, StarvationWatch]:
        frames = random_frames(2_000, mean_gap_s=1.5e-3)
        with StarvationWatch() as watch, open_bus("socketcan", vcan) as bus:
            report = transmit(bus, [frames], threading.Event())
        assert (report.frames_sent, report.frames_given_up) == (2_000, 0)
        assert report.duration_s >= frames.t_s[-1]
        return report, watch

    report, watch = undisturbed(attempt, lambda outcome: outcome[1].is_starved)
    if not watch.is_starved:
        assert report.lateness_p50_s < 0.005
        assert abs(report.drift_ppm) < 5_000
