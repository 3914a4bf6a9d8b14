"""Signals asked for through an ELM327 adapter and over IP: said on a bus of the process, where they are overheard."""

import os
import pty
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress

import can
import numpy as np
import pytest

from canlog.database.signal_columns import column_id
from canlog.frames import EXTENDED_FLAG, join
from diag_service.diagnosis.columns import Signal
from diag_service.mapping.asked_signals import Overheard
from diag_service.mapping.profile import AskingRules, load_shipped
from diag_service.tester.adapters import ELM_TOGETHER, line_through
from diag_service.tester.signal_asking import SignalAsker
from ecu_emulator.diagnostics.doip.listening import Place
from ecu_emulator.diagnostics.doip.server import DoipServer
from ecu_emulator.diagnostics.elm327.server import ElmServer
from tests.integration.test_signal_asking import controller, wait_for
from tests.support.asked import batch_of
from tests.support.ports import free_port

pytestmark = pytest.mark.asks

ASKED = load_shipped("dct_asked").asked


def overheard(channel: str, asker: Callable[[], SignalAsker]) -> dict[Signal, float]:
    """Return the raw values that are heard on a channel while somebody asks."""
    heard: list[can.Message] = []
    with can.Bus(channel, "virtual") as bus, can.Notifier(bus, [heard.append], timeout=0.05), asker() as one:
        wait_for(lambda: one.set_count >= 3)
        assert set(one.sent) == {0x22}
    reader = Overheard(list(ASKED.values()))
    out = join([*reader.feed(batch_of(list(heard))), *reader.drain()])
    values = np.ascontiguousarray(out.data).view("<f8")[:, 0]
    columns = {signal: column_id(field.name) | EXTENDED_FLAG for signal, field in ASKED.items()}
    return {signal: float(values[out.can_id == column][-1]) for signal, column in columns.items()}


def asking(adapter: str, channel: str, together: int) -> SignalAsker:
    return SignalAsker(ASKED, AskingRules(together=together), lambda: line_through(adapter, channel))


def check(values: dict[Signal, float]) -> None:
    assert values.keys() == ASKED.keys()
    assert values[Signal.CLUTCH1_PRESSURE] == 400.0
    assert values[Signal.ENGINE_TORQUE] == 2400.0


def test_an_adapter_at_a_serial_port_is_asked_and_overheard() -> None:
    ours, theirs = pty.openpty()
    with ElmServer(controller(), ("127.0.0.1", 0)) as server, socket.create_connection(server.address) as cable:

        def carry(read: Callable[[int], bytes], write: Callable[[bytes], object]) -> None:
            """Carry bytes one way until an end is pulled out."""
            with suppress(OSError):
                while piece := read(4096):
                    write(piece)

        threads = [
            threading.Thread(target=carry, args=(lambda size: os.read(ours, size), cable.sendall)),
            threading.Thread(target=carry, args=(cable.recv, lambda piece: os.write(ours, piece))),
        ]
        for one in threads:
            one.start()
        try:
            adapter = f"elm327:{os.ttyname(theirs)}"
            check(overheard("serial", lambda: asking(adapter, "serial", ELM_TOGETHER)))
        finally:
            os.close(theirs)
            cable.shutdown(socket.SHUT_RDWR)
            for one in threads:
                one.join()
            os.close(ours)


@contextmanager
def adapter(answer: Sequence[tuple[float, bytes]], greeting: bytes = b"") -> Iterator[str]:
    """Run an adapter that says to each request for data some bytes, each after a while [s]; yield its address."""

    def serve(server: socket.socket) -> None:
        connection, _ = server.accept()
        with connection:
            connection.sendall(greeting)
            while asked := connection.recv(64):
                for wait_s, piece in answer if asked.startswith(b"22") else [(0.0, b"OK\r\r>")]:
                    time.sleep(wait_s)
                    connection.sendall(piece)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve, args=(server,))
        thread.start()
        yield f"elm327://127.0.0.1:{server.getsockname()[1]}"
        thread.join()


def test_a_node_over_ip_that_dies_is_told_and_asked_again(caplog: pytest.LogCaptureFixture) -> None:
    place = Place(host="127.0.0.1", port=free_port())
    asker = asking(f"doip://127.0.0.1:{place.port}/1011", "doip 2", 8)
    with DoipServer(controller(), place):
        asker.__enter__()
        wait_for(lambda: asker.set_count >= 1)
    wait_for(lambda: "asking is interrupted: 1011 at DoIP" in caplog.text)
    count = asker.set_count
    with DoipServer(controller(), place):
        wait_for(lambda: asker.set_count > count)
        asker.end()


def test_a_node_over_ip_is_asked_and_overheard() -> None:
    with DoipServer(controller(), Place(host="127.0.0.1", port=free_port())) as server:
        adapter = f"doip://127.0.0.1:{server.place.port}/1011"
        check(overheard("doip", lambda: asking(adapter, "doip", 8)))
