"""A reader that is not ours, scapy's: reads a log of candump as a process and prints the UDS messages in it as JSON."""

import importlib
import json
import sys
from typing import Any


def main() -> None:
    can: Any = importlib.import_module("scapy.layers.can")
    utils: Any = importlib.import_module("scapy.contrib.isotp.isotp_utils")
    uds: Any = importlib.import_module("scapy.contrib.automotive.uds")
    builder = utils.ISOTPMessageBuilder(use_ext_address=False)
    told = []
    for frame in can.CandumpReader(sys.argv[1]):
        builder.feed(frame)
        while (message := builder.pop()) is not None:
            packet = uds.UDS(bytes(message.data))
            refusal = packet.sprintf("%UDS_NR.negativeResponseCode%") if packet.haslayer(uds.UDS_NR) else ""
            told.append(
                {
                    "can_id": int(frame.identifier),
                    "bytes": bytes(message.data).hex(),
                    "service": packet.sprintf("%UDS.service%"),
                    "refusal": refusal,
                }
            )
    print(json.dumps(told))


if __name__ == "__main__":
    main()
