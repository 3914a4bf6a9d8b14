"""A controller that is not ours, scapy's, as a process: ``-i INTERFACE -c CHANNEL``; answers until it is ended."""

import argparse
import importlib
from typing import Any


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-i", "--interface", required=True)
    parser.add_argument("-c", "--channel", required=True)
    parser.add_argument("--request-id", type=lambda text: int(text, 0), default=0x742)
    parser.add_argument("--response-id", type=lambda text: int(text, 0), default=0x75A)
    options = parser.parse_args()
    conf: Any = importlib.import_module("scapy.config").conf
    conf.contribs["CANSocket"] = {"use-python-can": True}
    conf.contribs["ISOTP"] = {"use-can-isotp-kernel-module": False}
    can: Any = importlib.import_module("scapy.contrib.cansocket")
    isotp: Any = importlib.import_module("scapy.contrib.isotp")
    uds: Any = importlib.import_module("scapy.contrib.automotive.uds")
    ecu: Any = importlib.import_module("scapy.contrib.automotive.ecu")
    bus = can.CANSocket(bustype=options.interface, channel=options.channel)
    socket = isotp.ISOTPSocket(bus, tx_id=options.response_id, rx_id=options.request_id, basecls=uds.UDS, padding=True)
    raw: Any = importlib.import_module("scapy.packet").Raw
    answers = [
        uds.UDS() / uds.UDS_TPPR(),
        uds.UDS() / uds.UDS_DSCPR(b"\x01\x00\x32\x01\xf4"),
        uds.UDS() / uds.UDS_RDBIPR(dataIdentifier=0xF190) / raw(b"WFOREIGN000000001"),
        uds.UDS() / uds.UDS_RDBIPR(dataIdentifier=0xF18C) / raw(b"A SERIAL NUMBER THAT TAKES SOME FRAMES"),
        uds.UDS() / uds.UDS_RDBIPR(dataIdentifier=0x38EB) / raw(b"\x01\x90"),
        uds.UDS(b"\x59\x01\xff\x00\x00\x02"),
        uds.UDS(b"\x59\x02\xff\x01\x23\x45\x2f\x9a\xbc\xde\x08"),
        uds.UDS(b"\x59\x04\x01\x23\x45\x2f\x01\x01\x12\x34\xaa\xbb"),
    ]
    machine = ecu.EcuAnsweringMachine(
        supported_responses=[ecu.EcuResponse(responses=answer) for answer in answers],
        main_socket=socket, basecls=uds.UDS, verbose=False,
    )  # fmt: skip
    print("answering", flush=True)
    machine()


if __name__ == "__main__":
    main()
