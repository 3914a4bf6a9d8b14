"""Whatever is typed, an adapter answers in lines, and OBD in answers that fit the request."""

from hypothesis import given, settings
from hypothesis import strategies as st

from workshop.controller.elm327 import Interpreter
from workshop.controller.table import shipped_table
from workshop_tests.controller.bench import Bench

COMMANDS = (
    "Z", "WS", "D", "I", "E0", "L1", "S0", "S1", "H0", "H1", "SP0", "SP6", "SP7", "SPA6", "TP3", "DP", "DPN", "PC",
    "SH7DF", "SH7E1", "SH7E0", "SHDA10F1", "CP18", "CRA", "CRA7E9", "CRA7XX", "CF7E8", "CM7F0", "AR", "CAF0", "CAF1",
    "CFC0", "CFC1", "FCSM0", "FCSM1", "FCSM2", "FCSH7E1", "FCSD300000", "FCSD31", "D0", "D1", "AL", "RV", "AT1",
    "ST32", "MA",
)  # fmt: skip
REQUESTS = ("0100", "010C0D1", "020200", "03", "04", "0902", "19020F", "1003", "22F190", "1009 22F190F187F1", "219701",
            "300000", "02010C", "0A", "06E1")  # fmt: skip
typed = st.one_of(
    st.sampled_from(COMMANDS).map(lambda command: f"AT{command}"),
    st.sampled_from(REQUESTS),
    st.binary(max_size=8).map(bytes.hex),
    st.text(max_size=20),
    st.text("AT0123456789ABCDEF \r", max_size=30),
)


@settings(max_examples=15, deadline=None)
@given(st.lists(typed, max_size=40))
def test_every_line_is_answered(lines: list[str]) -> None:
    bench = Bench(table=shipped_table())
    adapter = Interpreter(
        bench.table.addressing,
        bench.table.transport,
        lambda payload, to_all: bytes.fromhex(bench.ask(payload.hex(), to_all=to_all)) or None,
    )
    has_begun = False
    for text in lines:
        shown = adapter.execute(text)
        has_begun = has_begun or bool(text.strip())
        assert shown.lines or shown.monitors or not has_begun
        assert all(line and line.isascii() and line.isprintable() for line in shown.lines)


@settings(max_examples=100, deadline=None)
@given(st.integers(1, 10), st.binary(max_size=8), st.booleans())
def test_obd_answers_what_was_asked_or_nothing(service: int, parameters: bytes, to_all: bool) -> None:
    bench = Bench(table=shipped_table())
    answer = bytes.fromhex(bench.ask((bytes([service]) + parameters).hex(), to_all=to_all))
    if to_all:
        assert answer[:1] in {b"", bytes([service + 0x40])}
    elif answer[0] == 0x7F:
        assert answer in {bytes([0x7F, service, nrc]) for nrc in (0x11, 0x12)}
    else:
        assert answer[0] == service + 0x40
