"""An OBD app is tried without a car: python-OBD talks to the adapter that the emulated car has.

python scan_tool.py
"""

import obd

from ecu_emulator import Emulator
from workshop import Answers

PORT = 35000


def main(port=PORT):
    """Ask the driving car for engine speed and speed."""
    with Emulator("ideal", answers=Answers(elm327=str(port))) as car:
        car.wait_until(1.0, 300)
        adapter = obd.OBD(f"socket://127.0.0.1:{port}", baudrate=38400, fast=False, timeout=30)
        print(adapter.status())
        for command in (obd.commands.RPM, obd.commands.SPEED):
            print(command.name, adapter.query(command).value)
        adapter.close()


if __name__ == "__main__":
    main()
