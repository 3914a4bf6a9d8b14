"""An ELM327 line by line, as its data sheet has it, in front of the emulated controller."""

from dataclasses import replace
from functools import partial

import pytest

from workshop.controller.elm327 import Interpreter
from workshop.controller.table import engine_table, shipped_table
from workshop_tests.controller.bench import Bench


class Adapter:
    def __init__(self, *commands: str, bitrate: int | None = None, ids: tuple[int, int, int] | None = None) -> None:
        self.bench = Bench(table=shipped_table())
        table = self.bench.table
        addressing = table.addressing
        if ids is not None:
            addressing = replace(addressing, request_id=ids[0], response_id=ids[1], functional_id=ids[2])
        self.interpreter = Interpreter(addressing, table.transport, self._ask, bitrate)
        for command in commands:
            assert self.say(command) == ["OK"]

    def _ask(self, payload: bytes, is_functional: bool) -> bytes | None:
        return bytes.fromhex(self.bench.ask(payload.hex(), to_all=is_functional)) or None

    def say(self, text: str) -> list[str]:
        return list(self.interpreter.execute(text).lines)


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        ("ATZ", "ELM327 v1.5"),
        ("at ws", "ELM327 v1.5"),
        (" a T i ", "ELM327 v1.5"),
        ("AT@1", "OBDII to RS232 Interpreter"),
        ("ATRV", "12.6V"),
        ("ATDP", "AUTO"),
        ("ATDPN", "A0"),
        ("ATE0", "OK"),
        ("ATE2", "?"),
        ("ATAT2", "OK"),
        ("ATST FF", "OK"),
        ("ATST", "?"),
        ("ATSP", "?"),
        ("ATSPD", "?"),
        ("at sp 00", "OK"),
        ("ATSP01", "?"),
        ("ATIB10", "OK"),
        ("ATSW00", "OK"),
        ("ATWM 81 13 F1 3E", "OK"),
        ("ATKW0", "OK"),
        ("ATCTM5", "OK"),
        ("ATCEA 12", "OK"),
        ("ATBRD 23", "?"),  # there is no speed to change
        ("ATPP FF OFF", "OK"),
        ("ATPP 2D SV 0F", "?"),
        ("AT TP A0", "OK"),
        ("ATSH 7E1", "OK"),
        ("ATSH 7E", "?"),
        ("ATSH XYZ", "?"),
        ("ATCRA", "OK"),
        ("ATCRA 7EX", "OK"),
        ("ATCF 7E8", "OK"),
        ("ATFCSM1", "OK"),  # flow control is automatic all the same
        ("ATFCSM0", "OK"),
        ("ATFCSM3", "?"),
        ("ATFCSD", "?"),
        ("ATAL", "OK"),
        ("ATPC", "OK"),
        ("ATNOSUCH", "?"),
        ("AT", "?"),
        ("hello", "?"),
        ("\x7f\x7f", "?"),
        ("1", "?"),
    ],
)
def test_commands(command: str, answer: str) -> None:
    assert Adapter().say(command) == [answer]


@pytest.mark.parametrize(
    ("protocol", "bitrate", "ids", "answer"),
    [
        ("6", None, None, "41 0C 0C AF "),
        ("A6", None, None, "SEARCHING..."),
        ("8", 250_000, None, "41 0C 0C AF "),
        ("7", None, (0x18DA10F1, 0x18DAF110, 0x18DB33F1), "41 0C 0C AF "),
        ("9", 250_000, (0x18DA10F1, 0x18DAF110, 0x18DB33F1), "41 0C 0C AF "),
        ("7", None, None, "CAN ERROR"),
        ("8", None, None, "CAN ERROR"),
        ("A", None, None, "CAN ERROR"),
        ("1", None, None, "NO DATA"),
        ("3", None, None, "BUS INIT: ...ERROR"),
    ],
)
def test_protocols(protocol: str, bitrate: int | None, ids: tuple[int, int, int] | None, answer: str) -> None:
    assert Adapter(f"ATSP{protocol}", bitrate=bitrate, ids=ids).say("010C")[0] == answer


def test_headers_say_who_is_asked_and_filters_who_is_heard() -> None:
    adapter = Adapter("ATSP6", "ATSH 7E1")
    assert adapter.say("0102") == ["7F 01 12 "]  # to this one: refused
    assert adapter.say("22F190")[0] == "014"
    assert adapter.say("ATSH 7E0") == ["OK"]
    assert adapter.say("010C") == ["NO DATA"]
    assert adapter.say("ATSH 7DF") == ["OK"]
    assert adapter.say("0102") == ["NO DATA"]
    for address, is_heard in (("7E9", True), ("7E8", False), ("7EX", True), ("7DX", False), ("", True)):
        assert adapter.say(f"ATCRA{address}") == ["OK"]
        assert (adapter.say("010C") == ["41 0C 0C AF "]) is is_heard
    for commands in (("ATCF 7E0", "ATCM 7F0"), ("ATAR",)):
        assert [adapter.say(command) for command in commands] == [["OK"]] * len(commands)
        assert adapter.say("010C") == ["41 0C 0C AF "]


def test_each_controller_is_asked_by_its_header_and_all_by_the_functional_one() -> None:
    transmission, engine = Bench(table=shipped_table()), Bench(table=engine_table())

    def ask(bench: Bench, payload: bytes, is_functional: bool) -> bytes | None:
        return bytes.fromhex(bench.ask(payload.hex(), to_all=is_functional)) or None

    table, others = transmission.table, {engine.table.addressing: partial(ask, engine)}
    adapter = Interpreter(table.addressing, table.transport, partial(ask, transmission), None, others)
    for line in ("ATS0", "ATSP6"):
        adapter.execute(line)
    told = {}
    for header in ("7E0", "7E1", "7E2", "7DF"):
        adapter.execute(f"ATSH {header}")
        told[header] = list(adapter.execute("010D").lines)
    assert told == {"7E0": ["410D00"], "7E1": ["410D00"], "7E2": ["NO DATA"], "7DF": ["410D00", "410D00"]}
