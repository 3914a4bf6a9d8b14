"""An ELM327 line by line, as its data sheet has it, in front of the emulated controller."""

from dataclasses import replace

import pytest

from ecu_emulator.diagnostics.elm327.interpreter import Interpreter
from ecu_emulator.diagnostics.table_file import shipped_table
from tests.unit.ecu_emulator.diagnostics.bench import Bench

VIN = b"WDCTEMUL3TED00047"


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
        return list(self.interpreter.take(text).lines)


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
        ("ATFCSM1", "?"),  # header and data must be known before
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


def test_an_automatic_adapter_searches_once_and_then_names_the_protocol() -> None:
    adapter = Adapter("ATSP0")
    assert adapter.say("0100") == ["SEARCHING...", "41 00 98 38 80 13 "]
    assert adapter.say("0100") == ["41 00 98 38 80 13 "]
    assert adapter.say("ATDP") == ["AUTO, ISO 15765-4 (CAN 11/500)"]
    assert adapter.say("ATDPN") == ["A6"]
    assert adapter.say("ATD") == ["OK"]
    assert adapter.say("ATDPN") == ["A6"]
    assert adapter.say("ATPC") == ["OK"]
    assert adapter.say("0100")[0] == "SEARCHING..."


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


@pytest.mark.parametrize(
    ("commands", "answer"),
    [
        ((), "41 0C 0C AF "),
        (("ATS0",), "410C0CAF"),
        (("ATH1",), "7E9 04 41 0C 0C AF "),
        (("ATH1", "ATS0"), "7E904410C0CAF"),
        (("ATH1", "ATD1"), "7E9 8 04 41 0C 0C AF "),
    ],
)
def test_a_short_answer_as_settings_want_it(commands: tuple[str, ...], answer: str) -> None:
    assert Adapter("ATSP6", *commands).say("010C") == [answer]


def test_a_long_answer_without_headers_has_its_length_and_numbered_pieces() -> None:
    assert Adapter("ATSP6").say("0902") == [
        "014",
        "0: 49 02 01 " + VIN[:3].hex(" ").upper() + " ",
        "1: " + VIN[3:10].hex(" ").upper() + " ",
        "2: " + VIN[10:].hex(" ").upper() + " ",
    ]


def test_a_long_answer_with_headers_is_its_frames() -> None:
    assert Adapter("ATSP6", "ATH1", "ATS0").say("0902") == [
        "7E91014490201" + VIN[:3].hex().upper(),
        "7E921" + VIN[3:10].hex().upper(),
        "7E922" + VIN[10:].hex().upper(),
    ]


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


@pytest.mark.parametrize(
    ("commands", "is_whole"),
    [
        ((), True),
        (("ATCFC0",), False),
        (("ATFCSD 30 00 05", "ATFCSM2"), True),
        (("ATFCSD 32 00 00", "ATFCSM2"), False),
        (("ATFCSH 7E1", "ATFCSD 300000", "ATFCSM1"), True),
        (("ATFCSH 7E2", "ATFCSD 300000", "ATFCSM1"), False),
        (("ATFCSH 00 07 E1", "ATFCSD 300000", "ATFCSM1"), True),
    ],
)
def test_flow_control_decides_whether_the_rest_comes(commands: tuple[str, ...], is_whole: bool) -> None:
    assert len(Adapter("ATSP6", "ATH1", *commands).say("0902")) == (3 if is_whole else 1)


def test_an_unformatted_adapter_sends_what_it_is_given() -> None:
    adapter = Adapter("ATSP6", "ATCAF0", "ATSH7E1")
    assert adapter.say("02 01 0C") == ["04 41 0C 0C AF CC CC CC "]
    assert adapter.say("02 01 0C 00 00 00 00 00") == ["04 41 0C 0C AF CC CC CC "]
    assert adapter.say("03 01 0C") == ["NO DATA"]  # shorter than it says
    assert adapter.say("00 01 0C") == ["NO DATA"]
    assert adapter.say("02 01 0C 00 00 00 00 00 00") == ["?"]
    assert adapter.say("AT CAF1") == ["OK"]
    assert adapter.say("01 0C 0D 05 11 46 04 0B") == ["?"]  # eight bytes and no room for a length
