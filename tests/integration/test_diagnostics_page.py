"""The Python and the files that docs/diagnostics.md, docs/tester.md and docs/own-car.md show do what the pages say.

Its blocks for odxtools and python-OBD are run where those libraries are: tests/integration/test_uds_pdx.py,
tests/e2e/test_obd.py.
"""

import re
from collections.abc import Mapping
from pathlib import Path

import pytest
from udsoncan.configs import default_client_config

from diag_service.mapping.profile import load_profile
from diag_service.tester.description_files import load_file
from ecu_emulator.diagnostics.memory import TestResult as Result
from tests.integration.test_tester import vehicle
from tests.support.documents import page_text
from tests.support.doip.tester import entity
from tests.support.patience import HANG_S
from tests.support.uds.wire import parked_controller

PAGE = "docs/diagnostics.md"
TOO_HOT = 0x27874B  # P2787, confirmed in one cycle


def block(language: str, word: str, page: str = PAGE) -> str:
    """Return the block of a page that holds a word."""
    blocks = re.findall(rf"^```{language}\n(.*?)^```", page_text(page), re.MULTILINE | re.DOTALL)
    (found,) = (text for text in blocks if word in text)
    return str(found)


def run(text: str, replaced: Mapping[str, str]) -> None:
    """Run a block, with other places than those of the page."""
    for old, new in replaced.items():
        assert old in text
        text = text.replace(old, new)
    exec(compile(text, PAGE, "exec"), {"__name__": "page"})  # noqa: S102 - what the page is for


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the library wait for a busy machine."""
    for name, value in {"request_timeout": HANG_S, "p2_timeout": HANG_S, "use_server_timing": False}.items():
        monkeypatch.setitem(default_client_config, name, value)


def test_a_tester_on_the_bus(capsys: pytest.CaptureFixture[str]) -> None:
    controller = parked_controller()
    for _ in range(20):
        controller.report(TOO_HOT, Result.FAILED)
    with vehicle("page", controller):
        run(block("python", "PythonIsoTpConnection"), {"vcan0": "page", "socketcan": "virtual"})
    said = capsys.readouterr().out
    assert "WDCTEMUL3TED00047" in said
    assert f"0x{TOO_HOT:06x}" in said.lower()


def test_a_tester_over_ip() -> None:
    with entity() as (_, server):
        ports = f"tcp_port={server.place.port}, udp_port={server.place.port}"
        run(block("python", "doipclient"), {"0x1011)": f"0x1011, {ports})"})
        assert server.counts["requests"] == 1


def test_a_description_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "gearbox.toml"
    path.write_text(block("toml", 'name = "gearbox"', "docs/tester.md"), encoding="utf-8")
    described = load_file(path).description
    assert (described.name, described.request_id, described.response_id) == ("gearbox", 0x7E1, 0x7E9)
    values = described.values(described.find_data("oil"), bytes.fromhex("04 B0 01") + b"A7")
    assert values == {"temperature [degC]": 80.0, "state": "warm", "batch": "A7"}
    assert described.trouble_text(0x02184B) == "Transmission Fluid Over Temperature Condition"


def test_asked_signals_of_a_profile_are_read_as_shown(tmp_path: Path) -> None:
    path = tmp_path / "car.toml"
    path.write_text(block("toml", "did = ", "docs/own-car.md"), encoding="utf-8")
    profile = load_profile(path)
    (asked,) = profile.asked.values()
    assert (asked.number, asked.request_id, asked.is_signed) == (0x38EB, 0x7E1, True)
    assert {signal.value for signal in profile.sources} == {"clutch1_pressure_pa", "engine_speed_rad_s"}
