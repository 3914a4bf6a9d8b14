"""A tester that is not ours, udsoncan on doipclient, as a process: ``--port PORT``; prints JSON."""

import argparse
import json
import logging
from typing import Any

import doipclient
from doipclient import connectors, messages
from udsoncan.client import Client

from tests.support.uds.udsoncan_client import CONFIG, dialogue

ENTITY = 0x1011
DoIPClient: Any = doipclient.client.DoIPClient  # the library says nothing of types
DoIPClientUDSConnector: Any = connectors.DoIPClientUDSConnector


def refused(port: int, address: int) -> str:
    """Return what a tester with an address that it may not have is told."""
    try:
        DoIPClient("127.0.0.1", ENTITY, tcp_port=port, client_logical_address=address)
    except ConnectionRefusedError as exc:
        return str(exc)
    return ""


def told_by(port: int, version: int) -> dict[str, Any]:
    """Return all that the entity says, with the dialogue of a workshop."""
    told: dict[str, Any] = {}
    kind = messages.RoutingActivationRequest.ActivationType
    options = {
        "tcp_port": port,
        "udp_port": port,
        "protocol_version": version,
        "activation_type": kind.DiagnosticRequiredByRegulation,
    }
    with DoIPClient("127.0.0.1", ENTITY, **options) as tester:
        for name, found in (
            ("by request", tester.request_vehicle_identification()),
            ("by EID", tester.request_vehicle_identification(eid=bytes.fromhex("020000001011"))),
            ("by VIN", tester.request_vehicle_identification(vin="WDCTEMUL3TED00047")),
        ):
            told[name] = [found.vin, found.logical_address, found.eid.hex(), found.vin_sync_status]
        status = tester.request_entity_status()
        told["status"] = [
            status.node_type,
            status.max_concurrent_sockets,
            status.currently_open_sockets,
            status.max_data_size,
        ]
        told["power mode"] = int(tester.request_diagnostic_power_mode().diagnostic_power_mode)
        told["alive"] = tester.request_alive_check().source_address
        try:
            tester.send_diagnostic_to_address(0x1012, bytearray(b"\x3e\x00"))
        except OSError as exc:
            told["unknown target"] = str(exc)
        with Client(DoIPClientUDSConnector(tester), config=CONFIG) as client:
            told["dialogue"] = dialogue(client)
    told["unknown tester"] = refused(port, 0x0D00)
    return told


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--version", type=int, default=2)
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    print(json.dumps(told_by(options.port, options.version)))


if __name__ == "__main__":
    main()
