"""Asking controllers that are not ours, and our personalities asked by testers that are not ours."""

import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from itertools import count
from typing import Any

import can
import isotp
import pytest
from doipclient.client import DoIPClient
from doipclient.connectors import DoIPClientUDSConnector
from udsoncan.client import Client
from udsoncan.connections import BaseConnection, PythonIsoTpConnection
from udsoncan.Request import Request
from udsoncan.Response import Response
from udsoncan.services.ReadDataByIdentifier import ReadDataByIdentifier

from diag_service.diagnosis.columns import Signal
from diag_service.mapping.asked_signals import AskedField
from diag_service.mapping.profile import AskingRules, load_shipped
from tests.integration.test_other_senders import two_ends
from tests.integration.test_signal_asking import controller, wait_for
from tests.integration.test_tester import vehicle
from tests.support.ports import free_port
from tests.support.uds.udsoncan_client import CONFIG, ISO_TP, Number
from workshop.controller.doip_server import DoipAddress, DoipServer
from workshop.tester.can_line import line_on
from workshop.tester.signal_asking import SignalAsker, address_of

pytestmark = pytest.mark.asks

ASKED = load_shipped("dct_asked").asked
TOLD = {0x100C: 2400, 0x380C: 2000, 0x380D: 1500, 0x38EB: 400, 0x38EA: 0, 0x2104: 800}
NUMBERS = count()
Node: Any = DoIPClient  # the library says nothing of types
Connector: Any = DoIPClientUDSConnector


@contextmanager
def car_of_udsoncan(bus: can.BusABC) -> Iterator[None]:
    """Put a controller on a bus whose transport is can-isotp's and whose messages are udsoncan's."""
    address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E9, rxid=0x7E1)
    over = threading.Event()

    def answer(payload: bytes) -> bytes:
        request = Request.from_payload(payload)
        if request.service is not ReadDataByIdentifier:
            return bytes(Response(request.service, Response.Code.ServiceNotSupported).get_payload())
        data = request.data or b""
        numbers = [int.from_bytes(data[at : at + 2]) for at in range(0, len(data), 2)]
        found = b"".join(one.to_bytes(2) + TOLD[one].to_bytes(2) for one in numbers if one in TOLD)
        return bytes(Response(request.service, Response.Code.PositiveResponse, data=found).get_payload())

    with can.Notifier(bus, [], timeout=0.05) as notifier:
        stack = isotp.NotifierBasedCanStack(bus, notifier, address=address, params={"tx_padding": 0})

        def serve() -> None:
            while not over.is_set():
                if (request := stack.recv(block=True, timeout=0.05)) is not None:
                    stack.send(answer(bytes(request)))

        thread = threading.Thread(target=serve)
        stack.start()
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
            stack.stop()


@contextmanager
def asked(fields: Mapping[Signal, AskedField], bus: can.BusABC, *, define: bool = False) -> Iterator[SignalAsker]:
    addresses = [address_of(one) for one in fields.values()]
    asker = SignalAsker(
        fields,
        AskingRules(together=8, define=define),
        lambda: line_on(bus, addresses, is_fd=False, listen_s=0.05, goes_on=lambda: asker.goes_on),
    )
    with asker:
        yield asker


@pytest.mark.asks(may_define=True)
@pytest.mark.parametrize(
    ("kind", "define"),
    [("virtual", False), ("this machine", True), pytest.param("socketcan", True, marks=pytest.mark.vcan)],
)
def test_a_car_of_can_isotp_and_udsoncan_is_asked(request: pytest.FixtureRequest, kind: str, *, define: bool) -> None:
    channel = str(request.getfixturevalue("vcan")) if kind == "socketcan" else f"foreign {next(NUMBERS)}"
    with two_ends(kind, channel) as (car, tester), car_of_udsoncan(car), asked(ASKED, tester, define=define) as asker:
        wait_for(lambda: asker.set_count >= 3)
        assert set(asker.sent) == ({0x22, 0x2C} if define else {0x22})


@pytest.mark.parametrize("way", ["can", "doip"])
def test_our_personality_tells_udsoncan(way: str) -> None:
    numbers: dict[int, Any] = dict.fromkeys((0x100C, 0x38EB, 0x38EA, 0x2104), Number(">h"))
    config: Any = {**CONFIG, "data_identifiers": numbers}
    channel = f"foreign {next(NUMBERS)}"
    with ExitStack() as stack:
        connection: BaseConnection
        if way == "doip":
            server = stack.enter_context(DoipServer(controller(), DoipAddress(host="127.0.0.1", port=free_port())))
            port = server.place.port
            node = stack.enter_context(closing(Node("127.0.0.1", 0x1011, tcp_port=port, udp_port=port)))
            connection = Connector(node)
        else:
            stack.enter_context(vehicle(channel, controller()))
            bus = stack.enter_context(can.Bus(channel, "virtual"))
            notifier = stack.enter_context(can.Notifier(bus, [], timeout=0.05))
            address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E1, rxid=0x7E9)
            transport = isotp.NotifierBasedCanStack(bus, notifier, address=address, params=ISO_TP)
            connection = PythonIsoTpConnection(transport)
        client = stack.enter_context(Client(connection, config=config))
        told: Any = client.read_data_by_identifier(list(numbers))
        assert told.service_data.values == {0x100C: 2400, 0x38EB: 400, 0x38EA: 0, 0x2104: 800}
