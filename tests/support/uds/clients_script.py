"""A client that is not ours goes through a workshop's list, as a process: prints each request and answer as JSON.

``python -m tests.support.uds.clients_script CLIENT -i INTERFACE -c CHANNEL --doip PORT --elm327 PORT``. Each makes
its requests and takes the answers apart by its own code; what it has no call for is not asked.
"""

import argparse
import asyncio
import importlib
import io
import json
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

MASK = 0x5AA5C33C
PENDING = 0x78
SILENCE_S = 30.0
NODE = 0x1011
REQUEST_ID, RESPONSE_ID = 0x7E1, 0x7E9
LIST = (
    "10 03",
    "3e 00",
    "22 f1 90",
    "19 02 08",
    "19 06 27 87 4b 01",
    "27 01",
    "27 02",  # and the key
    "2e f1 98 43 4c 55 54 43 48 53 48 4f 50",
    "2f 02 06 03 78",
    "2c 01 f3 00 f1 90 01 03",
    "28 00 01",
    "85 01",
    "31 01 03 03",
    "14 27 88 00",
    "2a 01 01",
    "2a 04",
    "11 03",
)
"""What is asked over UDS; the last one ends the session."""

Exchange = tuple[bytes, bytes]
Ask = Callable[
    [bytes], Exchange | None
]  # a request of the list; what was sent and answered, None: the client has no call


def go_through(ask: Ask) -> dict[str, list[str]]:
    """Return request and answer, as they were on the wire, by what the list says."""
    told: dict[str, list[str]] = {}
    key = b""
    for line in LIST:
        exchange = ask(bytes.fromhex(line) + (key if line == "27 02" else b""))
        if exchange is None:
            continue
        request, response = exchange
        told[line] = [request.hex(" "), response.hex(" ")]
        if line == "27 01":
            key = (int.from_bytes(response[2:], "big") ^ MASK).to_bytes(4, "big")
    return told


# --- udsoncan, on can-isotp and on doipclient


class _Bytes:
    """Data of udsoncan's codecs as they are."""

    def __init__(self, size: int) -> None:
        self.size = size

    def encode(self, data: bytes) -> bytes:
        return data

    def decode(self, payload: bytes) -> bytes:
        return payload

    def __len__(self) -> int:
        return self.size


def _by_udsoncan(client: Any) -> Ask:  # noqa: ANN401 - imported by its own process alone
    """Return the calls of udsoncan's client, by service; its connection tells what it sends."""
    udsoncan: Any = importlib.import_module("udsoncan")
    sent: list[bytes] = []
    send = client.conn.send

    def noted_send(data: Any, *rest: Any, **more: Any) -> None:  # noqa: ANN401 - the library's
        sent.append(data if isinstance(data, bytes) else data.get_payload())
        send(data, *rest, **more)

    client.conn.send = noted_send
    calls: dict[int, Callable[[bytes], Any]] = {
        0x10: lambda request: client.change_session(request[1]),
        0x3E: lambda _: client.tester_present(),
        0x22: lambda request: client.read_data_by_identifier([int.from_bytes(request[1:3], "big")]),
        0x19: lambda request: (
            client.get_dtc_by_status_mask(request[2])
            if request[1] == 2
            else client.get_dtc_extended_data_by_dtc_number(
                int.from_bytes(request[2:5], "big"), record_number=request[5], data_size=1
            )
        ),
        0x27: lambda request: client.request_seed(1) if request[1] == 1 else client.send_key(2, request[2:]),
        0x2E: lambda request: client.write_data_by_identifier(int.from_bytes(request[1:3], "big"), request[3:]),
        0x2F: lambda request: client.io_control(int.from_bytes(request[1:3], "big"), request[3], [request[4:]]),
        0x2C: lambda request: client.dynamically_define_did(
            0xF300, udsoncan.DynamicDidDefinition(source_did=0xF190, position=request[6], memorysize=request[7])
        ),
        0x28: lambda request: client.communication_control(request[1], request[2]),
        0x85: lambda request: client.control_dtc_setting(request[1]),
        0x31: lambda request: client.start_routine(int.from_bytes(request[2:4], "big")),
        0x14: lambda request: client.clear_dtc(int.from_bytes(request[1:4], "big")),
        0x11: lambda request: client.ecu_reset(request[1]),
    }

    def ask(request: bytes) -> Exchange | None:
        if request[0] not in calls:
            return None
        sent.clear()
        calls[request[0]](request)
        return sent[0], bytes(client.last_response.original_payload)

    return ask


_UDSONCAN: dict[str, Any] = {
    "data_identifiers": {0xF190: _Bytes(17), 0xF198: _Bytes(10), 0xF300: _Bytes(3), 0x0206: _Bytes(1)},
    "input_output": {0x0206: _Bytes(1)},
    "request_timeout": SILENCE_S,
    "p2_timeout": SILENCE_S,
    "p2_star_timeout": SILENCE_S,
    "use_server_timing": False,
}


def _codecs(config: dict[str, Any]) -> dict[str, Any]:
    """Return a configuration whose codecs are udsoncan's, without importing it for other clients."""
    udsoncan: Any = importlib.import_module("udsoncan")
    codec = type("Codec", (_Bytes, udsoncan.DidCodec), {})
    kinds = ("data_identifiers", "input_output")
    made = {kind: {number: codec(one.size) for number, one in config[kind].items()} for kind in kinds}
    return {**importlib.import_module("udsoncan.configs").default_client_config, **config, **made}


@contextmanager
def _stack(options: argparse.Namespace) -> Iterator[Any]:
    """Yield a transport layer of can-isotp."""
    can: Any = importlib.import_module("can")
    isotp: Any = importlib.import_module("isotp")
    address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=REQUEST_ID, rxid=RESPONSE_ID)
    with can.Bus(options.channel, options.interface) as bus, can.Notifier(bus, [], timeout=0.05) as notifier:
        yield isotp.NotifierBasedCanStack(bus, notifier, address=address, params={"tx_padding": 0})


def udsoncan_on_can(options: argparse.Namespace) -> dict[str, list[str]]:
    client: Any = importlib.import_module("udsoncan.client").Client
    connection: Any = importlib.import_module("udsoncan.connections").PythonIsoTpConnection
    with _stack(options) as stack, client(connection(stack), config=_codecs(_UDSONCAN)) as one:
        return go_through(_by_udsoncan(one))


def udsoncan_on_doipclient(options: argparse.Namespace) -> dict[str, list[str]]:
    client: Any = importlib.import_module("udsoncan.client").Client
    node = importlib.import_module("doipclient").DoIPClient("127.0.0.1", NODE, tcp_port=options.doip)
    connector: Any = importlib.import_module("doipclient.connectors").DoIPClientUDSConnector
    try:
        with client(connector(node), config=_codecs(_UDSONCAN)) as one:
            return go_through(_by_udsoncan(one))
    finally:
        node.close()


# --- scapy


def scapy(options: argparse.Namespace) -> dict[str, list[str]]:
    conf: Any = importlib.import_module("scapy.config").conf
    conf.contribs["CANSocket"] = {"use-python-can": options.interface != "socketcan"}
    conf.contribs["ISOTP"] = {"use-can-isotp-kernel-module": False}
    cansocket: Any = importlib.import_module("scapy.contrib.cansocket")
    isotp: Any = importlib.import_module("scapy.contrib.isotp")
    uds: Any = importlib.import_module("scapy.contrib.automotive.uds").UDS
    raw: Any = importlib.import_module("scapy.packet").Raw
    named = {} if options.interface == "socketcan" else {"bustype": options.interface}
    bus = cansocket.CANSocket(channel=options.channel, **named)
    with isotp.ISOTPSocket(bus, tx_id=REQUEST_ID, rx_id=RESPONSE_ID, basecls=uds, padding=True) as socket:

        def ask(request: bytes) -> Exchange | None:
            packet = uds(request)  # taken apart, and put together again when it is sent
            if isinstance(packet.payload, raw):
                return None
            packet = uds(bytes(packet))
            answer = socket.sr1(packet, timeout=SILENCE_S, verbose=False)
            while answer is not None and bytes(answer)[:1] == b"\x7f" and bytes(answer)[2] == PENDING:
                (answer,) = socket.sniff(count=1, timeout=SILENCE_S)
            if answer is None or not answer.answers(packet):
                raise SystemExit(f"scapy: {request.hex(' ')}: no answer that it takes for one")
            return bytes(packet), bytes(answer)

        return go_through(ask)


# --- odxtools and the PDX


def odxtools(options: argparse.Namespace) -> dict[str, list[str]]:
    database: Any = importlib.import_module("odxtools.database").Database(use_weakrefs=False)
    with open(options.pdx, "rb") as file:  # noqa: PTH123 - what the library reads is a stream
        database.add_pdx_file(io.BytesIO(file.read()))
    database.refresh()
    layer = database.diag_layer_containers[0].base_variants[0]
    with _stack(options) as stack:
        stack.start()

        def ask(request: bytes) -> Exchange | None:
            message = layer.decode(request)[0]
            free = {one.short_name for one in message.service.request.free_parameters}
            coded = bytes(
                message.service.encode_request(
                    **{name: value for name, value in message.param_dict.items() if name in free}
                )
            )
            stack.send(coded)
            response = b"\x7f" + request[:1] + bytes([PENDING])
            while response[:1] == b"\x7f" and response[2] == PENDING:
                response = bytes(stack.recv(block=True, timeout=SILENCE_S) or b"")
            message.service.decode_message(response)
            return coded, response

        try:
            return go_through(ask)
        finally:
            stack.stop()


# --- gallia


def gallia(options: argparse.Namespace) -> dict[str, list[str]]:
    return asyncio.run(_by_gallia(options.doip))


def _overheard(transport: Any) -> tuple[list[bytes], list[bytes]]:  # noqa: ANN401 - likewise
    """Return lists of what a transport sends and hears from now on."""
    sent: list[bytes] = []
    heard: list[bytes] = []
    write, read = transport.write, transport.read

    async def noted_write(data: bytes, *rest: Any, **more: Any) -> Any:  # noqa: ANN401 - the library's
        sent.append(bytes(data))
        return await write(data, *rest, **more)

    async def noted_read(*rest: Any, **more: Any) -> bytes:  # noqa: ANN401 - likewise
        heard.append(bytes(await read(*rest, **more)))
        return heard[-1]

    transport.write, transport.read = noted_write, noted_read
    return sent, heard


async def _by_gallia(port: int) -> dict[str, list[str]]:
    transports: Any = importlib.import_module("gallia.transports")
    client_class: Any = importlib.import_module("gallia.services.uds.core.client").UDSClient
    place = f"doip://127.0.0.1:{port}?activation_type=0&src_addr=0x0e00&target_addr={NODE:#x}"
    transport = transports.DoIPTransport(transports.TargetURI(place))
    await transport.connect()
    sent, heard = _overheard(transport)
    client = client_class(transport, timeout=SILENCE_S)
    calls: dict[int, Callable[[bytes], Any]] = {
        0x10: lambda request: client.diagnostic_session_control(request[1]),
        0x3E: lambda _: client.tester_present(),
        0x22: lambda request: client.read_data_by_identifier(int.from_bytes(request[1:3], "big")),
        0x19: lambda request: (
            client.read_dtc_information_report_dtc_by_status_mask(request[2])
            if request[1] == 2
            else client.report_dtc_extended_data_record_by_dtc_number(request[2:5], request[5])
        ),
        0x27: lambda request: (
            client.security_access_request_seed(1)
            if request[1] == 1
            else client.security_access_send_key(2, request[2:])
        ),
        0x2E: lambda request: client.write_data_by_identifier(int.from_bytes(request[1:3], "big"), request[3:]),
        0x2F: lambda request: client.input_output_control_by_identifier(
            int.from_bytes(request[1:3], "big"), request[3:]
        ),
        0x2C: lambda request: client.define_by_identifier(0xF300, 0xF190, request[6], request[7]),
        0x28: lambda request: client.communication_control(request[1], request[2]),
        0x85: lambda request: client.control_dtc_setting(request[1]),
        0x31: lambda request: client.routine_control_start_routine(int.from_bytes(request[2:4], "big")),
        0x14: lambda request: client.clear_diagnostic_information(int.from_bytes(request[1:4], "big")),
        0x11: lambda request: client.ecu_reset(request[1]),
    }
    told: dict[str, list[str]] = {}
    key = b""
    for line in LIST:
        request = bytes.fromhex(line) + (key if line == "27 02" else b"")
        if request[0] not in calls:
            continue
        sent.clear()
        await calls[request[0]](request)
        told[line] = [sent[0].hex(" "), heard[-1].hex(" ")]
        if line == "27 01":
            key = (int.from_bytes(heard[-1][2:], "big") ^ MASK).to_bytes(4, "big")
    await transport.close()
    return told


# --- python-OBD


def python_obd(options: argparse.Namespace) -> dict[str, list[str]]:
    obd: Any = importlib.import_module("obd")
    car = obd.OBD(f"socket://127.0.0.1:{options.elm327}", fast=False, timeout=5)
    commands = {
        "01 00": obd.commands.PIDS_A,
        "02 0c": obd.commands.DTC_RPM,
        "03": obd.commands.GET_DTC,
        "06 00": obd.commands.MIDS_A,
        "07": obd.commands.GET_CURRENT_DTC,
        "09 00": obd.commands.PIDS_9A,
        "04": obd.commands.CLEAR_DTC,  # the last one of all
    }
    told: dict[str, list[str]] = {}
    try:
        for line, command in commands.items():
            response = car.query(command, force=True)
            told[line] = [line, bytes(response.messages[0].data).hex(" ") if response.messages else ""]
    finally:
        car.close()
    return told


CLIENTS: dict[str, Callable[[argparse.Namespace], dict[str, list[str]]]] = {
    "udsoncan": udsoncan_on_can,
    "scapy": scapy,
    "odxtools": odxtools,
    "doipclient": udsoncan_on_doipclient,
    "gallia": gallia,
    "python-OBD": python_obd,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("client", choices=CLIENTS)
    parser.add_argument("-i", "--interface", default="socketcan")
    parser.add_argument("-c", "--channel", default="vcan0")
    parser.add_argument("--doip", type=int, default=13400)
    parser.add_argument("--elm327", type=int, default=35000)
    parser.add_argument("--pdx", default="tcu.pdx")
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    print(json.dumps(CLIENTS[options.client](options)))


if __name__ == "__main__":
    main()
