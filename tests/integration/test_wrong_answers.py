"""A controller that answers wrongly: whatever it says, nothing untrue is told."""

import os
import signal
import threading
import time
from pathlib import Path

import can
import pytest

from diag_service.errors import ControllerError, SilentError, StoppedError
from diag_service.tester.addresses import CanAddress
from diag_service.tester.can_link import CanConnection
from diag_service.tester.scanning import find_addresses
from tests.support.in_process import ended
from tests.support.patience import HANG_S
from tests.support.uds.wrong_answers import QUESTIONS, told
from tests.support.uds.wrong_ecu import REQUEST_ID, RESPONSE_ID, WAYS, Fault, wrong_ecu


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", QUESTIONS)
def test_nothing_untrue_is_told(name: str, way: str, tmp_path: Path) -> None:
    found = told(name, way, tmp_path)
    assert found.is_true, found


class SaysWait(can.Listener):
    """Answers the first frame of a long request with "wait" (ISO 15765-2)."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus

    def on_message_received(self, msg: can.Message) -> None:
        if msg.data[0] >> 4 == 1:
            self._bus.send(can.Message(arbitration_id=RESPONSE_ID, is_extended_id=False, data=b"\x31\x00\x00"))


def test_who_shall_stop_does_not_wait_while_a_controller_says_wait() -> None:
    looks = iter([True, True, True, False])
    address = CanAddress(request_id=REQUEST_ID, response_id=RESPONSE_ID)
    with (
        can.Bus("says wait", "virtual") as near,
        can.Bus("says wait", "virtual") as far,
        can.Notifier(near, [SaysWait(near)], timeout=0.05),
    ):
        connection = CanConnection(far, address, goes_on=lambda: next(looks))
        with pytest.raises(StoppedError, match="not everything was asked"):
            connection.specific_send(bytes(20))


def test_a_request_that_is_not_taken_in_full_is_told_as_such() -> None:
    address = CanAddress(request_id=REQUEST_ID, response_id=RESPONSE_ID)
    with (
        can.Bus("half", "virtual") as near,
        can.Bus("half", "virtual") as far,
        can.Notifier(near, [SaysWait(near)], timeout=0.05),
        pytest.raises(SilentError, match=r"^7E1 \(answers 7E9\) does not take the whole of the request 31 01 03 01 00"),
    ):
        CanConnection(far, address).specific_send(bytes.fromhex("31 01 03 01") + bytes(16))


def test_ctrl_c_ends_a_wait_for_a_controller_that_asks_for_time() -> None:
    pending = Fault(request="1902", way=lambda _, __: [b"\x03\x7f\x19\x78"])
    with wrong_ecu("ctrl-c", pending) as ecu:

        def stop() -> None:
            deadline_s = time.monotonic() + HANG_S
            while "1902AF" not in ecu.asked and time.monotonic() < deadline_s:
                time.sleep(0.01)
            os.kill(os.getpid(), signal.SIGINT)

        thread = threading.Thread(target=stop)
        thread.start()
        run = ended("dtc", "-i", "virtual", "-c", "ctrl-c", "--listen", "0", "--active")
        thread.join()
    assert (run.status, run.out) == (130, "")
    assert "stopped early: not everything was asked" in run.err


def test_a_scan_changes_no_session() -> None:
    with wrong_ecu("no session") as ecu:
        words = ("-i", "virtual", "-c", "no session", "--listen", "0", "--first", "7E1", "--last", "7E1", "--active")
        assert ended("scan", *words).status == 0
        assert ecu.asked
        assert {request[:2] for request in ecu.asked} <= {"3E", "22", "19"}


def test_a_scan_gives_way_to_another_tester() -> None:
    with can.Bus("gives way", "virtual") as other, can.Bus("gives way", "virtual") as bus:
        other.send(can.Message(arbitration_id=0x7E0, is_extended_id=False, data=b"\x02\x3e\x80"))
        with pytest.raises(ControllerError, match=r"another tester began to ask on this bus \(requests on 7E0\)"):
            find_addresses(bus, [0x7E5], frozenset(), wait_s=HANG_S)
