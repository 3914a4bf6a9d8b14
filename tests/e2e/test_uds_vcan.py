"""The tester on a real bus beside the emulator's full stream, and can-utils as a reader of what was said."""

import subprocess

import pytest

from tests.e2e.test_uds import emulator
from tests.support.bus_end import listener_count, wait_for_listener
from tests.support.in_process import ended
from tests.support.patience import HANG_S
from tests.tools.uds_dialogue import kinds_read

PATIENT = ("--active", "--listen", "0.3", "--timeout", "20")


@pytest.mark.vcan
def test_a_scan_finds_the_controller_and_isotpdump_reads_the_same(vcan: str) -> None:
    bus = ("-i", "socketcan", "-c", vcan)
    reader = ["stdbuf", "-oL", "isotpdump", "-s", "7E1", "-d", "7E9", vcan]
    before = listener_count(vcan)
    with subprocess.Popen(reader, stdout=subprocess.PIPE, text=True) as dump:
        wait_for_listener(vcan, before + 2, dump)  # of both identifiers
        with emulator(bus, {}):
            scanned = ended("scan", *bus, *PATIENT, "--first", "7E0", "--last", "7E3", "--wait", "0.5", "--json")
            codes = ended("dtc", *bus, *PATIENT, "--all", "--brief", "--json")
        dump.terminate()
        read = dump.communicate(timeout=HANG_S)[0]
    assert (scanned.status, codes.status) == (0, 0), (scanned.err, codes.err)
    (found,) = scanned.records[0]["controllers"]
    assert (found["request_id"], found["response_id"]) == ("7E1", "7E9")
    assert [one["number"] for one in found["services"] if one["there"]] == ["3E", "22", "19"]
    assert len(codes.records[0]["codes"]) == 25
    assert "62 F1 90 57 44 43" in read  # the first frame of the VIN
    kinds = kinds_read(read)
    assert kinds["FF"] >= 2  # VIN and codes
    assert kinds["CF"] > kinds["FF"] >= kinds["FC"] > 0
