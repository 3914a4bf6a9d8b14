"""The programs of examples/bench run as they stand, and the fixture of the workshop gives a car that they could use."""

import re
import runpy
from collections.abc import Callable

import pytest

from ecu_emulator import EmulatorConfigError
from tests.support.documents import ROOT, page_text
from tests.support.patience import HANG_S
from tests.support.ports import free_port
from workshop.pytest_plugin import VirtualCar

BENCH = ROOT / "examples" / "bench"


def output_of(name: str, capsys: pytest.CaptureFixture[str], **arguments: object) -> str:
    main: Callable[..., None] = runpy.run_path(str(BENCH / name))["main"]
    main(**arguments)
    return capsys.readouterr().out


def test_a_trouble_code_is_simulated_and_read_by_udsoncan(capsys: pytest.CaptureFixture[str]) -> None:
    assert output_of("trouble_codes.py", capsys) == "before: []\nafter: ['084164']\n"


def test_python_obd_talks_to_the_adapter(capsys: pytest.CaptureFixture[str]) -> None:
    status, rpm, speed = output_of("scan_tool.py", capsys, port=free_port()).splitlines()
    assert status == "Car Connected"
    assert 700 < float(rpm.split()[1]) < 6500
    assert speed.startswith("SPEED ")


def test_scapy_asks_who_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert output_of("identity.py", capsys) == "WDCTEMUL3TED00047\n"


def test_a_simulator_moves_the_car(capsys: pytest.CaptureFixture[str]) -> None:
    told = re.fullmatch(r"(\d+) frames, changes to the gears \[2, 3.*\]\n", output_of("driving_simulator.py", capsys))
    assert told is not None
    assert int(told[1]) > 5000


def test_every_example_is_listed_and_played() -> None:
    programs = {path.name for path in BENCH.glob("*.py")}
    assert set(re.findall(r"\[(\w+\.py)\]", page_text("examples/bench/README.md"))) == programs
    source = (ROOT / "tests/integration/test_bench_examples.py").read_text(encoding="utf-8")
    assert {name for name in programs if f'output_of("{name}"' in source} == programs


def test_a_virtual_car_with_a_cause_that_there_is_not_says_which_there_are(
    virtual_car: Callable[..., VirtualCar],
) -> None:
    with pytest.raises(EmulatorConfigError, match=r"aged-fluid, water, .*, glazed-lining, .* got 'rust'"):
        virtual_car(cause="rust")


def test_a_virtual_car_has_its_cause_its_bus_its_tester_and_its_truth(virtual_car: Callable[..., VirtualCar]) -> None:
    car = virtual_car("ideal", cause="glazed_lining", strength=1.5, clutch=1, seed=7)
    (cause,) = car.truth.drive.causes
    assert (cause.kind, cause.strength, cause.clutch) == ("glazed-lining", 1.5, 1)
    assert car.bus.recv(HANG_S) is not None
    (vin,) = car.uds.data("F190")
    assert vin.values == {"VIN": "WDCTEMUL3TED00047"}
    car.emulator.add_fault({"quantity": "clutch1_pressure_pa", "kind": "not_available"})
    while "P0841" not in {code.code for code in car.uds.trouble_codes()}:
        assert car.emulator.is_driving
