"""ELM327 adapters at serial ports: their rate is found and told, and characters of value 0 are none."""

import os
import pty
import termios
from contextlib import ExitStack

import pytest

from canlog.errors import NOTICE
from diag_service.errors import ControllerError
from tests.integration.test_signal_asking import controller
from tests.support.serial_adapter import serial_adapter
from workshop.controller.elm327_server import ElmServer
from workshop.tester.adapters import ElmLine
from workshop.tester.addresses import CanAddress

pytestmark = pytest.mark.asks

GEARBOX = CanAddress(request_id=0x7E1, response_id=0x7E9)
PRESSURE, ANSWER = bytes.fromhex("2238EB"), bytes.fromhex("6238EB0190")


@pytest.mark.parametrize(
    ("rate", "name"), [(termios.B38400, "38400"), (termios.B115200, "115200"), (termios.B9600, "9600")]
)
def test_the_rate_of_a_serial_adapter_is_found_and_told(rate: int, name: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(NOTICE)
    with (
        ElmServer(controller(), ("127.0.0.1", 0)) as server,
        serial_adapter(server.address, rate) as port,
        ExitStack() as stack,
    ):
        assert ElmLine(port, stack, lambda: True).ask(PRESSURE, GEARBOX) == ANSWER
    assert f"adapter {port}: {name} baud" in caplog.text


def test_a_port_with_nobody_at_it_names_the_rates_that_were_tried() -> None:
    words = "does not answer at 38400, 115200 or 9600 baud"
    near, far = pty.openpty()
    try:
        with ExitStack() as stack, pytest.raises(ControllerError, match=words):
            ElmLine(os.ttyname(far), stack, lambda: True)
    finally:
        os.close(near)
        os.close(far)
