"""The emulator and a DoIP tester as processes: the car drives, the tester asks for everything."""

import json
import signal
import subprocess
import sys

from tests.e2e.test_uds import emulator
from tests.support.patience import HANG_S
from tests.support.ports import free_port


def test_a_workshop_tester_asks_a_car_that_drives_over_ip() -> None:
    port = free_port()
    with emulator(["-i", "virtual", "-c", "doip"], {}, "--doip", str(port)) as program:
        words = [sys.executable, "-m", "tests.support.doip.doipclient_tester", "--port", str(port)]
        client = subprocess.run(words, check=False, capture_output=True, text=True, timeout=HANG_S)
        program.send_signal(signal.SIGINT)
        out, err = program.communicate(timeout=HANG_S)
    assert client.returncode == 0, client.stderr
    told = json.loads(client.stdout)
    dialogue = told.pop("dialogue")
    identity = ["WDCTEMUL3TED00047", 0x1011, "020000001011", 0]
    assert told == {
        "by request": identity,
        "by EID": identity,
        "by VIN": identity,
        "status": [1, 4, 1, 4095],
        "power mode": 1,
        "alive": 0x1011,
        "unknown target": "Diagnostic request rejected with negative acknowledge code: 3",
        "unknown tester": "Activation Request failed with code 0",
    }
    assert dialogue["vin"] == "WDCTEMUL3TED00047"
    assert dialogue["live"]["258"] > 100  # more than 1 km/h: the drive begins rolling
    assert [dialogue[name] for name in ("locked", "session", "no key", "written", "default")] == [
        0x7F, 3, 0x33, "CLUTCHSHOP", 1,
    ]  # fmt: skip
    assert program.returncode == 0, err
    counts = json.loads(out)["diagnostics"]
    assert counts["doip"]["connections"] == 2
    assert counts["doip"]["requests"] > 20
    assert counts["requests"] == 0  # nobody asked over CAN
    assert "; DoIP: " in err
