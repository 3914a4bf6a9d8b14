"""Faults at run time: the control socket's answers, and that a fault asked for happens."""

import json
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from ecu_emulator.drive.recording import Drive
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.live import ControlSocket
from ecu_emulator.scenario.faults import BusFault, BusFaultKind, SensorFault, SensorFaultKind
from tests.support.builders import drive_scenario
from tests.support.patience import HANG_S


@pytest.fixture
def taken() -> list[SensorFault | BusFault]:
    return []


@pytest.fixture
def path(tmp_path: Path, taken: list[SensorFault | BusFault]) -> Iterator[Path]:
    where = tmp_path / "control"
    with ControlSocket(where, taken.append):
        yield where
    assert not where.exists()


def answers(path: Path, *lines: str) -> list[str]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
        caller.settimeout(HANG_S)
        caller.connect(str(path))
        caller.sendall("".join(f"{line}\n" for line in lines).encode())
        caller.shutdown(socket.SHUT_WR)
        with caller.makefile(encoding="utf-8") as stream:
            return stream.read().splitlines()


def test_faults_are_taken_by_the_keys_of_a_scenario(path: Path, taken: list[SensorFault | BusFault]) -> None:
    loss = {"kind": "loss", "share": 0.5, "duration_s": 2}
    offset = {"quantity": "engine_torque_nm", "kind": "offset", "size": 20}
    assert answers(path, json.dumps(loss), json.dumps(offset)) == ["ok", "ok"]
    assert taken == [
        BusFault(kind=BusFaultKind.LOSS, share=0.5, duration_s=2.0),
        SensorFault(quantity="engine_torque_nm", kind=SensorFaultKind.OFFSET, size=20.0),
    ]


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("loss", "error: not JSON"),
        ("[" * 4000, "error: not JSON"),
        ("[]", "error: a fault must be a table"),
        ("{}", "error: kind is missing"),
        ('{"kind": "los"}', "error: kind must be one of loss"),
        ('{"kind": "loss", "share": 2}', "error: share must be"),
        ('{"kind": "loss", "share": NaN}', "error: share must be"),
        ('{"quantity": "mood_k", "kind": "frozen"}', "error: quantity 'mood_k' has no sensor"),
        ("\xff", "error: "),
    ],
)
def test_a_line_that_cannot_be_used_says_why_and_the_next_one_counts(
    path: Path, taken: list[SensorFault | BusFault], line: str, answer: str
) -> None:
    first, second = answers(path, line, '{"kind": "silence"}')
    assert first.startswith(answer)
    assert second == "ok"
    assert len(taken) == 1


def test_only_the_owner_may_connect(path: Path) -> None:
    assert path.stat().st_mode & 0o077 == 0


def test_a_drive_takes_faults_while_it_runs() -> None:
    drive = Drive(drive_scenario(seed=41))
    stretches = drive.stretches(2.0)
    next(stretches)
    asked = threading.Thread(
        target=drive.add_fault, args=(BusFault(kind=BusFaultKind.BAD_CRC, message="TCU_Shift", duration_s=0.5),)
    )
    asked.start()
    asked.join()
    drive.add_fault(
        SensorFault(quantity="hub_speed_rad_s", kind=SensorFaultKind.OFFSET, size=3.0, start_s=1.0, duration_s=0.1)
    )
    with pytest.raises(EmulatorConfigError, match="not on the bus"):
        drive.add_fault(BusFault(kind=BusFaultKind.LOSS, message="Radio"))
    foreign = SensorFault(quantity="turbine_speed_rad_s", kind=SensorFaultKind.FROZEN)
    with pytest.raises(EmulatorConfigError, match="'turbine_speed_rad_s' is not on the bus; known: "):
        drive.add_fault(foreign)
    with pytest.raises(EmulatorConfigError, match="is not on the bus"):
        Drive(replace(drive_scenario(), sensor_faults=(foreign,)))
    next(stretches)
    offset, crc = drive.totals.faults
    assert (crc.what, crc.count) == ("TCU_Shift", 50)
    assert crc.t_start_s == pytest.approx(2.0, abs=0.01)
    assert (offset.what, offset.count) == ("hub_speed_rad_s", 10)
    assert offset.t_start_s == pytest.approx(3.0, abs=0.01)
