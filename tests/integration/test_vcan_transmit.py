"""The emulator's sending end on a real vcan: full buffers, an interface that goes away."""

import socket
import threading

import pytest

from ecu_emulator.bus.sender import TransmitReport, open_bus, transmit
from ecu_emulator.cli import main
from ecu_emulator.errors import BusError
from tests.support.bus_end import raw_socket
from tests.support.starvation import StarvationWatch, undisturbed
from tests.support.traffic import random_frames
from tests.uml.vcan import ip_link

pytestmark = pytest.mark.vcan


def switch_off_amid(raw: socket.socket, vcan: str) -> None:
    """Switch an interface off once a tenth of a second of a drive was heard on it."""
    with raw:
        for _ in range(60):
            raw.recv(16)
    ip_link("set", vcan, "down")


def test_an_interface_switched_off_while_sending_is_one_clear_error(
    vcan: str, capsys: pytest.CaptureFixture[str]
) -> None:
    thread = threading.Thread(target=switch_off_amid, args=(raw_socket(vcan), vcan))
    thread.start()
    status = main(["run", "-i", "socketcan", "-c", vcan, "--scenario", "noise_only", "--json"])
    thread.join()
    said = capsys.readouterr()
    assert (status, said.out) == (3, "")
    assert said.err.splitlines()[-1].startswith("ecu-emulator: error: the bus went away after")


def test_an_interface_that_is_down_says_what_to_do(vcan: str) -> None:
    assert ip_link("set", vcan, "down")
    with pytest.raises(BusError, match=f"is down: switch it on .ip link set {vcan} up"):
        open_bus("socketcan", vcan)


def test_an_unknown_interface_says_what_to_do() -> None:
    with pytest.raises(BusError, match=r"no CAN interface 'vcan99': create it .ip link add vcan99 type vcan"):
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
