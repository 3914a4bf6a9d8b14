"""A tester that is not ours, udsoncan on can-isotp, as a process: ``-i INTERFACE -c CHANNEL``; prints JSON."""

import argparse
import json
import logging
import struct
import time
from collections.abc import Callable
from typing import Any

import can
import isotp
import udsoncan
from udsoncan.client import Client
from udsoncan.connections import PythonIsoTpConnection
from udsoncan.exceptions import NegativeResponseException, TimeoutException
from udsoncan.Request import Request
from udsoncan.Response import Response

from tests.support.starvation import TRIES, StarvationWatch

MASK = bytes.fromhex("5aa5c33c")
SILENCE_S = 30.0  # only a hang takes so long
BROKEN_OFF_S = 0.5  # ISO-TP ends a transfer whose next frame is a second late: a machine so busy may be the cause
TESTER_PRESENT = bytes.fromhex("3e00")
ACTIVE_SESSION = bytes.fromhex("22f186")


class Number(udsoncan.DidCodec):
    def __init__(self, layout: str) -> None:
        self.layout = layout

    def encode(self, *values: object) -> bytes:
        return struct.pack(self.layout, *values)

    def decode(self, payload: bytes) -> object:
        values = struct.unpack(self.layout, payload)
        return values[0] if len(values) == 1 else list(values)

    def __len__(self) -> int:
        return struct.calcsize(self.layout)


def key_of(seed: bytes, **_: object) -> bytes:
    return bytes(one ^ other for one, other in zip(seed, MASK, strict=True))


CONFIG: Any = {
    "data_identifiers": {
        0xF190: udsoncan.AsciiCodec(17),
        0xF186: Number(">B"),
        0xF198: udsoncan.AsciiCodec(10),
        0x0101: Number(">I"),
        0x0102: Number(">H"),
        0x0103: Number(">BB"),
        0x0105: Number(">H"),
        0x0206: Number(">B"),
    },
    "security_algo": key_of,
    "request_timeout": SILENCE_S,
    "p2_timeout": SILENCE_S,
    "p2_star_timeout": SILENCE_S,
    "use_server_timing": False,  # the machine may be busy
    "dtc_snapshot_did_size": 2,
    "tolerate_zero_padding": True,
}

ISO_TP: Any = {
    "tx_padding": 0,
    "rx_flowcontrol_timeout": int(SILENCE_S * 1000),
    "rx_consecutive_frame_timeout": int(SILENCE_S * 1000),
}


def refusal(call: Callable[[], object]) -> int:
    """Return the negative response code of a call, 0 if it was answered."""
    try:
        call()
    except NegativeResponseException as exc:
        return int(exc.response.code or 0)
    return 0


class PatientClient(Client):
    """Asks once more if nothing came and the machine was too busy for the time limits of ISO-TP."""

    def send_request(self, request: Request, timeout: int = -1) -> Response | None:
        for _ in range(TRIES - 1):
            with StarvationWatch() as watch:
                try:
                    return super().send_request(request, timeout)
                except TimeoutException:
                    if watch.worst_s < BROKEN_OFF_S:
                        raise
        return super().send_request(request, timeout)


def wait_until_it_answers(client: Client) -> None:
    """Ask until an answer comes, then take the answers to all that was asked: none may pass for a later one."""
    deadline_s = time.monotonic() + 10 * SILENCE_S
    client.conn.send(TESTER_PRESENT)
    while client.conn.wait_frame(timeout=1.0) is None:
        if time.monotonic() > deadline_s:
            raise SystemExit("nobody answers")
        client.conn.send(TESTER_PRESENT)
    client.conn.send(ACTIVE_SESSION)
    while answer := client.conn.wait_frame(timeout=SILENCE_S):
        if answer.startswith(b"\x62" + ACTIVE_SESSION[1:]):
            return
    raise SystemExit("it no longer answers")


def dialogue(client: Client) -> dict[str, Any]:
    """Use every service that the controller has, as a workshop would."""
    told: dict[str, Any] = {}
    asked: Any = client  # its answers are typed as perhaps missing
    while asked.read_data_by_identifier([0x0103]).service_data.values[0x0103][0] not in range(1, 7):
        time.sleep(0.05)  # the first frames of the drive are not out yet
    told["vin"] = asked.read_data_by_identifier([0xF190]).service_data.values[0xF190]
    told["live"] = asked.read_data_by_identifier([0x0102, 0x0103, 0x0105, 0x0206]).service_data.values
    told["supported"] = asked.get_supported_dtc().service_data.dtc_count
    told["by mask"] = asked.get_number_of_dtc_by_status_mask(0x08).service_data.dtc_count
    told["confirmed"] = [dtc.id for dtc in asked.get_dtc_by_status_mask(0x08).service_data.dtcs]
    told["snapshots"] = asked.get_dtc_snapshot_identification().service_data.dtc_count
    told["extended data"] = asked.get_dtc_extended_data_by_dtc_number(0x081107, data_size=1).service_data.dtc_count
    told["locked"] = refusal(lambda: client.write_data_by_identifier(0xF198, "CLUTCHSHOP"))
    client.change_session(3)
    told["session"] = asked.read_data_by_identifier([0xF186]).service_data.values[0xF186]
    told["no key"] = refusal(lambda: client.write_data_by_identifier(0xF198, "CLUTCHSHOP"))
    client.unlock_security_access(1)
    client.write_data_by_identifier(0xF198, "CLUTCHSHOP")
    told["written"] = asked.read_data_by_identifier([0xF198]).service_data.values[0xF198]
    client.control_dtc_setting(1)
    client.communication_control(0, 1)
    told["while driving"] = [
        refusal(lambda: client.ecu_reset(1)), refusal(lambda: client.control_dtc_setting(2)),
        refusal(lambda: client.communication_control(3, 1)), refusal(lambda: client.clear_dtc(0xFFFFFF)),
    ]  # fmt: skip
    told["routine"] = refusal(lambda: client.start_routine(0x0999))
    with client.suppress_positive_response(wait_nrc=False):
        client.tester_present()
    client.change_session(1)
    told["default"] = asked.read_data_by_identifier([0xF186]).service_data.values[0xF186]
    return told


def failed_codes(client: Client) -> dict[str, Any]:
    """Wait until a test has failed; return status and snapshot numbers of every such code."""
    asked: Any = client
    deadline_s = time.monotonic() + 10 * SILENCE_S
    while not (found := asked.get_dtc_by_status_mask(0x02).service_data.dtcs) and time.monotonic() < deadline_s:
        time.sleep(0.1)
    stored = asked.get_dtc_snapshot_identification().service_data.dtcs
    return {
        "status": {f"{dtc.id:06X}": dtc.status.get_byte_as_int() for dtc in found},
        "snapshots": {f"{dtc.id:06X}": list(dtc.snapshots) for dtc in stored},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-i", "--interface", required=True)
    parser.add_argument("-c", "--channel", required=True)
    parser.add_argument("--request-id", type=lambda text: int(text, 0), default=0x7E1)
    parser.add_argument("--failed", action="store_true", help="wait for a code whose test fails, and tell of it")
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=options.request_id, rxid=options.request_id + 8)
    with can.Bus(options.channel, options.interface) as bus, can.Notifier(bus, [], timeout=0.05) as notifier:
        stack = isotp.NotifierBasedCanStack(bus, notifier, address=address, params=ISO_TP)
        with PatientClient(PythonIsoTpConnection(stack), config=CONFIG) as client:
            wait_until_it_answers(client)
            print(json.dumps(failed_codes(client) if options.failed else dialogue(client)))


if __name__ == "__main__":
    main()
