"""Random logs in formats of the wild, written after the sources and examples of the programs that make them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import MappingProxyType

from tests.support.log_grammars import START_S, Frame, Grammar, busmaster, busmaster_header, by_hand, hex_text, id_text

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
LOCAL_START = (EPOCH + timedelta(seconds=START_S)).astimezone()
CONSOLE_TIMES = {
    "a": lambda t_us: f"({START_S + t_us // 1_000_000:010d}.{t_us % 1_000_000:06d}) ",
    "z": lambda t_us: f"({t_us // 1_000_000:03d}.{t_us % 1_000_000:06d}) ",
    "A": lambda t_us: f"({LOCAL_START + timedelta(microseconds=t_us):%Y-%m-%d %H:%M:%S.%f}) ",
}


def _shown(data: bytes, mark: str) -> str:
    return mark + "".join(chr(byte) if 0x1F < byte < 0x7F else "." for byte in data) + mark


def _console_frame(frame: Frame, *, has_ascii: bool, is_swapped: bool) -> str:
    """Return what ``sprint_long_canframe`` of can-utils writes of a frame."""
    if frame.is_error:
        return f"20000000   [0] {'ERRORFRAME':>37}"
    length = f"[{frame.length:02d}] " if frame.is_fd else f" [{frame.length}] "
    head = f"{id_text(frame, 3)}  {length}"
    if frame.is_remote:
        return head + " remote request"
    pairs = [f"{byte:02X}" for byte in frame.data]
    text = head + (" " + ("`".join(reversed(pairs)) if is_swapped else " ".join(pairs)) if pairs else "")
    if not has_ascii or frame.length > 8:
        return text
    shown = _shown(frame.data[::-1], "`") if is_swapped else _shown(frame.data, "'")
    return text + " " * (3 * (8 - frame.length) + 3) + shown


def _console(
    time: str, *, has_flags: bool = False, has_ascii: bool = False, is_swapped: bool = False, colour: str = ""
) -> Callable[[int, Frame], str]:
    """Return the lines that candump prints without ``-L``, after its source, candump.c and lib.c of can-utils."""

    def line(_: int, frame: Frame) -> str:
        flags = (
            f"  {'TX' if frame.is_sent else 'RX'} {'B' if frame.is_fast else '-'} {'E' if frame.is_passive else '-'}"
        )
        body = _console_frame(frame, has_ascii=has_ascii, is_swapped=is_swapped)
        stamp = CONSOLE_TIMES[time](frame.t_us) if time else ""
        end = "\x1b[0m" if colour else ""
        return f" {stamp} {colour}can{frame.channel}{flags if has_flags else ''}  {body}{end}"

    return line


def console_gaps(path: Path, frames: Sequence[Frame]) -> None:
    """Write what ``candump -t d`` prints: before each frame the time since the one before it."""
    line, last_us, lines = _console("z"), frames[0].t_us, list[str]()
    for frame in frames:
        lines.append(line(0, replace(frame, t_us=frame.t_us - last_us)) + "\n")
        last_us = frame.t_us
    path.write_text("".join(lines), encoding="ascii")


def _clx000(stamp: str, separator: str = ";") -> Callable[[int, Frame], str]:
    """Return the lines of a CLX000, after the examples in its manual, with times of any form."""

    def line(_: int, frame: Frame) -> str:
        moment = LOCAL_START + timedelta(microseconds=frame.t_us)
        time = moment.replace(tzinfo=None).strftime(stamp) + f"{moment.microsecond // 1_000:03d}"
        kind = frame.is_extended | frame.is_sent << 3
        return separator.join([time, str(kind), f"{frame.can_id:x}", frame.data.hex()])

    return line


def _clx000_header(start: str, separator: str = ";") -> tuple[str, ...]:
    return (
        "# Logger type: CL2000", "# HW rev: 7.05", "# FW rev: 5.82", "# Logger ID: OPEL", "# Session No.: 70",
        f"# Time: {LOCAL_START.strftime(start)}", f'# Value separator: "{separator}"', "# Time format: 4",
        '# Time and date separator: "T"', separator.join(("Timestamp", "Type", "ID", "Data")),
    )  # fmt: skip


def _busmaster_j1939(*, is_decimal: bool) -> Callable[[int, Frame], str]:
    def line(number: int, frame: Frame) -> str:
        time, _, channel, _, _, length, *_rest = busmaster(is_decimal=is_decimal)(number, frame).split()
        identifier = f"{frame.can_id}" if is_decimal else f"{frame.can_id:08x}"
        group = frame.can_id >> 8 & 0x3FFFF
        data = " ".join(f"{byte:03d}" for byte in frame.data) if is_decimal else hex_text(frame)
        direction = "Tx" if frame.is_sent else "Rx"
        source, priority = frame.can_id & 0xFF, frame.can_id >> 26
        node = f"0x{group:06X} NONE {source:02X}  FF  {priority:03d}"
        return f"{time} {channel} {identifier} {node} {direction} {length} {data} "

    return line


def _table(
    separator: str, time: Callable[[int], str], *, base: str = "X", has_kind: bool = True
) -> Callable[[int, Frame], str]:
    """Return lines of a table with every column that one can name."""

    def line(_: int, frame: Frame) -> str:
        kinds = [int(frame.is_extended), int(frame.is_remote), int(frame.is_error)] if has_kind else []
        data = hex_text(frame) if base == "X" else " ".join(map(str, frame.data))
        if separator == "," and len(frame.data) % 2:
            data = f'"{data}"'
        direction = "Tx" if frame.is_sent else "Rx"
        cells = [
            time(frame.t_us),
            f"can{frame.channel}",
            f"{frame.can_id:{base}}",
            *kinds,
            direction,
            frame.length,
            data,
        ]
        return separator.join(map(str, cells))

    return line


def _bytes_table(_: int, frame: Frame) -> str:
    cells = [
        f"{frame.t_us}",
        f"0x{frame.can_id:X}",
        *(f"{byte:02x}" for byte in frame.data),
        *[""] * (8 - frame.length),
    ]
    return ";".join([*cells, str(frame.length), "true" if frame.is_extended else "false", "note"])


TABLE_NAMES = ("Bus", "ID", "Extended", "RTR", "Error", "Dir", "DLC", "Data")


CONSOLE_GAPS = Grammar(
    write=console_gaps, start_us=0, has_fd=True, has_rates=False, has_direction=False, channels=10, leaves_open=True
)
WILD_GRAMMARS: Mapping[str, Grammar] = MappingProxyType({
    "candump-console -ta": Grammar(
        write=by_hand(_console("a")), has_fd=True, has_rates=False, has_direction=False, channels=10,
    ),
    "candump-console -tA -x -a": Grammar(
        write=by_hand(_console("A", has_flags=True, has_ascii=True)), has_fd=True, channels=10,
        has_direction_of_errors=True,
    ),
    "candump-console -tz -x -a -S -c": Grammar(
        write=by_hand(_console("z", has_flags=True, has_ascii=True, is_swapped=True, colour="\x1b[1m\x1b[34m")),
        leaves_open=True,
        start_us=0, has_fd=True, channels=10, has_direction_of_errors=True,
    ),
    "clx000 with days": Grammar(
        write=by_hand(_clx000("%dT%H%M%S"), _clx000_header("%Y%m%dT%H%M%S")), unit_us=100, step_us=1_000,
        has_remote=False, has_error=False,
    ),
    "clx000 with dates": Grammar(
        write=by_hand(_clx000("%Y/%m/%d %H:%M:%S.", "\t"), _clx000_header("%Y/%m/%d %H:%M:%S.", "\t"), "\r\n"),
        unit_us=100, step_us=1_000, has_remote=False, has_error=False,
    ),
    "busmaster of J1939": Grammar(
        write=by_hand(_busmaster_j1939(is_decimal=False), busmaster_header("HEX", "J1939")), unit_us=100,
        has_remote=False, has_error=False, channels=9, first_channel=1, is_always_extended=True,
    ),
    "busmaster of J1939 in decimal": Grammar(
        write=by_hand(_busmaster_j1939(is_decimal=True), busmaster_header("DEC", "J1939")), unit_us=100,
        has_remote=False, has_error=False, channels=9, first_channel=1, is_always_extended=True,
    ),
    "columns with commas": Grammar(
        write=by_hand(
            _table(",", lambda t_us: f"{START_S + t_us // 1_000_000}.{t_us % 1_000_000:06d}"),
            (",".join(("Time [s]", *TABLE_NAMES)),),
        ),
        has_fd=True, has_fd_flags=False, channels=10, leaves_open=True,
    ),
    "columns with tabs and dates": Grammar(
        write=by_hand(
            _table("\t", lambda t_us: f"{EPOCH + timedelta(seconds=START_S, microseconds=t_us):%Y-%m-%dT%H:%M:%S.%fZ}"),
            ("# a comment", "\t".join(("Timestamp", *TABLE_NAMES))), "\r\n",
        ),
        has_fd=True, has_fd_flags=False, channels=10, leaves_open=True,
    ),
    "columns in decimal": Grammar(
        write=by_hand(
            _table(";", lambda t_us: f"{t_us // 1_000_000},{t_us % 1_000_000:06d}", base="d"),
            ("Zeit_s;Kanal;ID (dec);Extended;RTR;Error;Dir;DLC;Data (dec)",),
        ),
        start_us=0, has_fd=True, has_fd_flags=False, channels=10, leaves_open=True,
    ),
    "columns for bytes": Grammar(
        write=by_hand(_bytes_table, ("t_us;Msg Id;D0;D1;D2;D3;D4;D5;D6;D7;Len;Ext;Comment",)), start_us=0,
        has_remote=False, has_error=False, has_direction=False, leaves_open=True,
    ),
})  # fmt: skip
