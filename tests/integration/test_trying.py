"""``diag-service try`` before the emulated controller: nothing unless allowed, then values, rate, and how to go on."""

from pathlib import Path

import pytest

from ecu_emulator.diagnostics.elm327.server import ElmServer
from tests.integration.test_signal_asking import controller, heard
from tests.integration.test_tester import vehicle
from tests.support.in_process import ended


def test_without_leave_nothing_is_sent() -> None:
    with heard("try 1") as ear:
        run = ended("try", "-i", "virtual", "-c", "try 1", "--listen", "0.05", "--profile", "vw_dsg")
        assert not ear.frames
    assert run.status == 0, run.err
    assert "vw_dsg would ask for 100C at 7E1, 380C at 7E1" in " ".join(run.out.split())
    assert "nothing was sent" in run.out


def test_values_rate_and_how_to_go_on_are_told() -> None:
    with heard("try 2") as ear, vehicle("try 2", controller()):
        run = ended("try", "-i", "virtual", "-c", "try 2", "--listen", "0.05", "--profile", "dct_asked", "--active")
    assert run.status == 0, run.err
    said = " ".join(run.out.split())
    assert "clutch1_pressure_pa = 4e+05 (38EB at 7E1)" in said
    assert "6 of 6 signals are told; friction beside 6 that are broadcast" in said
    assert "sets a second" in said
    assert "diag-service run -i virtual -c try 2 --profile dct_asked --active" in said
    assert ear.services() == {0x22}


def test_an_adapter_is_tried_with_every_profile_that_asks() -> None:
    with ElmServer(controller(), ("127.0.0.1", 0)) as server:
        place = f"elm327://127.0.0.1:{server.address[1]}"
        run = ended("try", "--adapter", place, "--active", "--listen", "0.05")
    assert run.status == 0, run.err
    assert "profile bmw_dkg:" in run.out
    assert "is refused, request out of range (31)" in " ".join(run.out.split())


@pytest.mark.parametrize(
    ("words", "text"), [(["--profile", "dct"], "asks for nothing"), (["--adapter", "x"], "--adapter")]
)
def test_what_cannot_be_tried_is_told(tmp_path: Path, words: list[str], text: str) -> None:
    run = ended("try", *words, "--active", "--listen", "0.05")
    assert run.status == 2
    assert text in run.err
