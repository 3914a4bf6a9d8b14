"""scapy asks the emulated controller who it is: UDS over ISO-TP on a bus of python-can.

python identity.py
"""

from scapy.config import conf

conf.contribs["ISOTP"] = {"use-can-isotp-kernel-module": False}
conf.contribs["CANSocket"] = {"use-python-can": True}

from scapy.contrib.automotive.uds import UDS, UDS_RDBI  # noqa: E402 - what is chosen above counts when they load
from scapy.contrib.cansocket import CANSocket  # noqa: E402
from scapy.contrib.isotp import ISOTPSocket  # noqa: E402

from ecu_emulator import Emulator  # noqa: E402
from workshop import Answers  # noqa: E402


def main():
    """Read the vehicle identification number."""
    with Emulator("ideal", answers=Answers()) as car:
        car.wait_until(1.0, 300)
        can = CANSocket(**car.bus_arguments, can_filters=[{"can_id": 0x7E9, "can_mask": 0x7FF}])
        with ISOTPSocket(can, tx_id=0x7E1, rx_id=0x7E9, basecls=UDS) as tester:
            answer = tester.sr1(UDS() / UDS_RDBI(identifiers=[0xF190]), timeout=300, verbose=False)
        can.close()
        print(bytes(answer)[3:].decode("ascii"))


if __name__ == "__main__":
    main()
