"""A controller that runs: what it keeps over a restart, and what it does when it cannot keep it."""

from collections.abc import Callable
from pathlib import Path

import pytest

from ecu_emulator.errors import RecordError
from tests.support.uds.full_table import full_table
from workshop.controller.controller import Controller, MemoryFile
from workshop.controller.memory import TestResult
from workshop_tests.controller.bench import PARKED, SEED

HOT = 0x27874B
KEY = (int.from_bytes(SEED[:4], "big") ^ 0x5AA5C33C).to_bytes(4, "big")


def controller(store: MemoryFile | None = None, clock: Callable[[], float] = lambda: 5.0) -> Controller:
    return Controller(full_table(), values=lambda: PARKED, clock=clock, chance=lambda count: SEED[:count], store=store)


def unlock(one: Controller) -> None:
    for request in (b"\x10\x03", b"\x27\x01", b"\x27\x02" + KEY):
        assert (one.ask(request) or b"")[0] == request[0] + 0x40


def test_codes_written_data_and_wrong_keys_outlive_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "memory.json"
    with MemoryFile(path, full_table()) as store:
        first = controller(store)
        first.report(HOT, TestResult.FAILED)
        unlock(first)
        assert first.ask(b"\x2e\x04\x00\x26\x11\x21") == b"\x6e\x04\x00"
        first.ask(b"\x10\x40")
        for _ in range(2):
            first.ask(b"\x27\x03")
            first.ask(b"\x27\x04" + bytes(8))
    with MemoryFile(path, full_table()) as store:
        second = controller(store)
        assert second.ask(b"\x19\x02\x08") == b"\x59\x02\xff\x27\x87\x4b\xed"  # failed until a test passes
        assert second.ask(b"\x22\x04\x00") == b"\x62\x04\x00\x26\x11\x21"
        second.ask(b"\x10\x03")
        second.ask(b"\x10\x40")
        assert second.ask(b"\x27\x03") == b"\x7f\x27\x37"


def test_what_cannot_be_kept_is_refused_and_forgotten(tmp_path: Path) -> None:
    folder = tmp_path / "disk"
    folder.mkdir()
    with MemoryFile(folder / "memory.json", full_table()) as store:
        one = controller(store)
        one.report(HOT, TestResult.FAILED)
        (folder / ".memory.json.part").mkdir()  # as a full disk, this stops the new file; for root as well
        assert one.ask(b"\x14\xff\xff\xff") == b"\x7f\x14\x72"
        with pytest.raises(RecordError, match=r"cannot write .*memory.json: Is a directory"):
            one.report(HOT, TestResult.PASSED)
        assert one.ask(b"\x19\x02\x08") == b"\x59\x02\xff\x27\x87\x4b\xaf"
        (folder / ".memory.json.part").rmdir()
        assert one.ask(b"\x14\xff\xff\xff") == b"\x54"


def _saved(path: Path) -> str:
    with MemoryFile(path, full_table()) as store:
        controller(store).report(HOT, TestResult.FAILED)
    return path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "damage",
    [
        lambda _: "",
        lambda text: text[:-20],
        lambda text: text.replace('"status": 175', '"status": 80'),
        lambda _: "[]",
        lambda _: "{}",
        lambda _: "[" * 100_000,
        lambda _: "61" * 100,
    ],
)
def test_a_damaged_file_is_not_believed(tmp_path: Path, damage: Callable[[str], str]) -> None:
    path = tmp_path / "memory.json"
    path.write_text(damage(_saved(path)), encoding="utf-8")
    with (
        MemoryFile(path, full_table()) as store,
        pytest.raises(RecordError, match=r"memory.json is damaged .*; move it away to begin with an empty memory"),
    ):
        controller(store)


def test_a_response_that_was_awaited_goes_to_the_client_who_asked() -> None:
    now_s = [5.0]
    one = controller(clock=lambda: now_s[0])
    for request in (b"\x10\x03", b"\x27\x01", b"\x27\x02" + KEY):
        one.ask(request, client=2)
    assert one.ask(b"\x31\x01\x03\x01\x04\x04", client=2) == b"\x7f\x31\x78"
    assert one.awaits(2)
    assert not one.awaits(0)
    now_s[0] += 4.0
    assert one.tick() is None
    assert one.tick(2) == b"\x7f\x31\x78"
    one.leave(2)
    assert not one.awaits(2)
