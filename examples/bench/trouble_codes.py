"""How to simulate a trouble code: a fault is set while the car drives, and udsoncan reads what the controller stores.

python trouble_codes.py
"""

import can
import isotp
from udsoncan.client import Client
from udsoncan.connections import PythonIsoTpConnection

from ecu_emulator import Emulator
from workshop import Answers

PATIENCE_S = 300


def read(client):
    """Return the codes whose test has failed since they were cleared, as bytes in hexadecimal."""
    return [f"{dtc.id:06X}" for dtc in client.get_dtc_by_status_mask(0x20).service_data.dtcs]


def main():
    """Ask before and after the pressure sensor of clutch 1 breaks."""
    with (
        Emulator("ideal", answers=Answers(), is_prompt=True) as car,
        car.open_bus() as bus,
        can.Notifier(bus, []) as frames,
    ):
        car.wait_until(1.0, PATIENCE_S)
        stack = isotp.NotifierBasedCanStack(bus, frames, address=isotp.Address(txid=0x7E1, rxid=0x7E9))
        with Client(PythonIsoTpConnection(stack), request_timeout=PATIENCE_S) as client:
            client.set_configs({"p2_timeout": PATIENCE_S, "use_server_timing": False})
            print("before:", read(client))
            car.add_fault({"quantity": "clutch1_pressure_pa", "kind": "not_available"})
            while not (codes := read(client)):
                pass
            print("after:", codes)  # P0841, failure type 64


if __name__ == "__main__":
    main()
