"""A scan tool that is not ours, as a process: python-OBD asks an ELM327 adapter, and prints what it was told as JSON.

``python -m tests.support.uds.python_obd_client PORT [REQUEST...]``; it then asks those alone.
"""

import json
import re
import sys
from collections.abc import Sequence
from typing import Any

import obd

from tests.support.documents import page_text


def page_rpm(port: str) -> float | None:
    """Return what the block of docs/controller.md is told."""
    (block,) = re.findall(
        r"^```python\n(import obd .*?)^```", page_text("docs/controller.md"), re.MULTILINE | re.DOTALL
    )
    *body, last = block.replace("35000", port).splitlines()
    names: dict[str, Any] = {}
    exec("\n".join(body), names)  # noqa: S102 - what the page is for
    try:
        return _magnitude(eval(last, names))  # noqa: S307 - likewise
    finally:
        names["car"].close()


def told(port: str) -> dict[str, Any]:
    """Return what the car says to a scan tool."""
    calibration = obd.OBDCommand("CAL_", "CAL_", b"0904", 0, _payload)  # its own strips 0, 1, 2 and x from both ends
    with_adapter = obd.OBD(f"socket://127.0.0.1:{port}", fast=False, timeout=5)
    try:
        values = {
            name: _magnitude(with_adapter.query(obd.commands[name]).value)
            for name in ("RPM", "SPEED", "COOLANT_TEMP", "THROTTLE_POS", "RUN_TIME", "AMBIANT_AIR_TEMP")
        }
        status = with_adapter.query(obd.commands.STATUS).value
        return {
            "state": with_adapter.status(),
            "protocol": with_adapter.protocol_name(),
            "supported": sorted(command.name for command in with_adapter.supported_commands),
            "values": values,
            "lamp": status.MIL,
            "count": status.DTC_count,
            "confirmed": [code for code, _ in with_adapter.query(obd.commands.GET_DTC).value],
            "pending": [code for code, _ in with_adapter.query(obd.commands.GET_CURRENT_DTC).value],
            "vin": bytes(with_adapter.query(obd.commands.VIN, force=True).value).decode("ascii"),
            "calibration": with_adapter.query(calibration, force=True).value,
            "clear": with_adapter.query(obd.commands.CLEAR_DTC, force=True).value,
            "page_rpm": page_rpm(port),
        }
    finally:
        with_adapter.close()


def answers(port: str, requests: Sequence[str]) -> list[str]:
    """Return what the transmission answers to requests, hexadecimal."""
    with_adapter = obd.OBD(f"socket://127.0.0.1:{port}", fast=False, timeout=5)
    try:
        commands = [
            obd.OBDCommand(one, one, one.encode(), 0, lambda said: bytes(said[0].data).hex().upper(), header=b"7E1")
            for one in requests
        ]
        return [with_adapter.query(one, force=True).value for one in commands]
    finally:
        with_adapter.close()


def _payload(messages: Sequence[Any]) -> str:
    return bytes(messages[0].data[3:]).rstrip(b"\0").decode("ascii")


def _magnitude(value: Any) -> float | None:  # noqa: ANN401 - untyped
    return None if value is None else float(value.magnitude)


if __name__ == "__main__":
    print(json.dumps(answers(sys.argv[1], sys.argv[2:]) if sys.argv[2:] else told(sys.argv[1])))
