"""ELM327 adapters at serial ports: their rate is found and told, and characters of value 0 are none."""

import os
import pty
import termios
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from socketserver import StreamRequestHandler, TCPServer

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


@contextmanager
def scripted(lines: Mapping[str, str]) -> Iterator[str]:
    """Yield the place of an adapter on the network that answers each line so, and all others with OK."""

    class Adapter(StreamRequestHandler):
        def handle(self) -> None:
            heard = b""
            while piece := self.request.recv(4096):
                *commands, heard = (heard + piece).split(b"\r")
                for command in commands:
                    self.wfile.write(f"{lines.get(command.decode(), 'OK')}\r\r>".encode("ascii"))

    with TCPServer(("127.0.0.1", 0), Adapter) as server:
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        try:
            yield f"127.0.0.1:{server.server_address[1]}"
        finally:
            thread.join()


@pytest.mark.parametrize(
    ("output", "answer"),
    [
        ("7F2278", "7F2278"),  # its time for an answer was over
        ("7F2278\r6238EB0190", "6238EB0190"),
        ("7F2231\r6238EB0190", "6238EB0190"),  # the refusal is that of the request before
        ("7F2221", "7F2221"),
    ],
)
def test_an_adapter_tells_late_answers_from_those_that_were_asked_for(output: str, answer: str) -> None:
    lines = {"22009A": "NO DATA"} if "31" in output else {}
    with scripted({**lines, "2238EB": output}) as place, ExitStack() as stack:
        line = ElmLine(place, stack, lambda: True)
        for request in lines:
            assert line.ask(bytes.fromhex(request), GEARBOX) is None
        assert line.ask(PRESSURE, GEARBOX) == bytes.fromhex(answer)
