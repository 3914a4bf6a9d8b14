"""The emulator's sending end on a real vcan: full buffers, an interface that goes away."""

import json
import threading
import time
from contextlib import closing, suppress

import pytest

from canlog.live.socketcan import grow_receive_buffer
from ecu_emulator.bus.sender import TransmitReport, open_bus, transmit
from ecu_emulator.cli import main
from ecu_emulator.errors import BusError
from tests.support.beside import Beside
from tests.support.bus_end import RECEIVE_BYTES, raw_socket
from tests.support.patience import HANG_S
from tests.support.starvation import StarvationWatch, undisturbed
from tests.support.traffic import random_frames
from tests.uml.vcan import create_vcan, ip_link

pytestmark = pytest.mark.vcan


DOWN_S = 10.0
QUIET_S = 60.0  # in which a guest, however slow, sends a frame


class Listener(Beside):
    """Counts the frames of an interface while it is entered, also after that was down."""

    def __init__(self, vcan: str) -> None:
        super().__init__()
        self._raw = raw_socket(vcan)
        grow_receive_buffer(self._raw, int(RECEIVE_BYTES))
        self._raw.settimeout(0.2)
        self.frame_count = 0

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        self._raw.close()

    def _work(self) -> None:
        is_last = False
        while not is_last:
            is_last = self._is_over.is_set()
            with suppress(OSError):  # nothing came, or the interface is down
                while self._raw.recv(16):
                    self.frame_count += 1


def wait_for_frames(listener: Listener, count: int) -> None:
    deadline_s = time.monotonic() + HANG_S
    while listener.frame_count < count and time.monotonic() < deadline_s:
        time.sleep(0.01)


def hear(vcan: str, most: int) -> int:
    """Return how many frames came before a long silence, at most so many."""
    with closing(raw_socket(vcan)) as raw, suppress(TimeoutError):
        raw.settimeout(QUIET_S)
        for count in range(most):
            if not raw.recv(16):
                return count
        return most
    return 0


def switch_off_and_on(listener: Listener, vcan: str) -> None:
    """Switch an interface off once a tenth of a second of a drive was heard on it, and on again after ten seconds."""
    wait_for_frames(listener, 60)
    ip_link("set", vcan, "down")
    time.sleep(DOWN_S)
    ip_link("set", vcan, "up")


def test_an_interface_that_is_down_for_ten_seconds_costs_the_frames_of_these_and_no_more(
    vcan: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with Listener(vcan) as listener:
        thread = threading.Thread(target=switch_off_and_on, args=(listener, vcan))
        thread.start()
        status = main(["run", "-i", "socketcan", "-c", vcan, "--scenario", "noise_only", "--cycles", "1", "--json"])
        thread.join()
    said = capsys.readouterr()
    result = json.loads(said.out)
    assert status == 0
    assert result["is_complete"]
    assert result["interruptions"] == 1
    assert "the interface was down 1 times" in said.err
    assert said.err.count("; waiting for its return") == said.err.count(f"socketcan {vcan} is there again after") == 1
    assert listener.frame_count == result["frames_sent"]
    lost_s = result["frames_given_up"] / (result["frames_sent"] + result["frames_given_up"]) * result["duration_s"]
    assert lost_s == pytest.approx(DOWN_S, abs=2.0)  # a guest may be late with either command


def test_an_adapter_that_is_pulled_is_waited_for(vcan: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Its interface goes away, and comes back as another one of that name."""
    heard: list[int] = []

    def pull_and_plug() -> None:
        heard.append(hear(vcan, 60))
        ip_link("delete", vcan)
        time.sleep(2.0)
        create_vcan(vcan)
        heard.append(hear(vcan, 60))

    thread = threading.Thread(target=pull_and_plug)
    thread.start()
    status = main(["run", "-i", "socketcan", "-c", vcan, "--scenario", "noise_only", "--cycles", "1", "--json"])
    thread.join()
    said = capsys.readouterr()
    result = json.loads(said.out)
    assert status == 0, said.err
    assert result["is_complete"]
    assert result["interruptions"] == 1
    assert result["frames_given_up"] > 0
    assert heard == [60, 60]
    assert said.err.count("; waiting for its return") == said.err.count(f"socketcan {vcan} is there again after") == 1


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
