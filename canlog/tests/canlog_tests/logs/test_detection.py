"""What a file is taken for: a header, or most of its first lines; one line that fits proves nothing."""

import pytest

from canlog.errors import SourceError
from canlog.logs.detection import LogFormat, detect, utf_16_of

LINES = {
    LogFormat.CANDUMP: b"(1700000000.000000) can0 0A0#0011223344556677",
    LogFormat.ASC: b"1.5 1  A0 Rx d 2 01 02",
    LogFormat.TRC: b"  1)     1841 0001 8 00 11 22 33 44 55 66 77",
    LogFormat.CSV: b"0.5,0x1,0,0,0,1,AQ==",
    LogFormat.GVRET: b"166064000,0000021A,false,1,2,FE,36",
    LogFormat.BUSMASTER: b"16:49:37:3329 Rx 1 0x144 s 1 5E",
    LogFormat.CRTD: b"12.6 1R11 402 00",
    LogFormat.CONSOLE: b"  can0  0A0   [8]  11 22 33 44 55 66 77 88",
}
HEADERS = {
    LogFormat.ASC: b"base hex  timestamps absolute",
    LogFormat.TRC: b";$FILEVERSION=2.1",
    LogFormat.CSV: b"timestamp,arbitration_id,extended,remote,error,dlc,data",
    LogFormat.GVRET: b"Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2",
    LogFormat.BUSMASTER: b"***BUSMASTER Ver 3.2.2***",
    LogFormat.CLX000: b"# Logger type: CL2000",
}
PROSE = b"What was measured on the second day, with the same car:"


@pytest.mark.parametrize(("log_format", "line"), LINES.items())
def test_most_of_the_first_lines_decide(log_format: LogFormat, line: bytes) -> None:
    found = detect(b"\n".join([PROSE, line, line, b"", b"# comment", line]))
    assert found.format is log_format
    assert found.evidence == "3 of the first 4 lines are frames in its grammar"


@pytest.mark.parametrize(
    "line",
    [
        b"46,016\t1\t0004\t45A\t8\t5A 04 00 00 00 00 00 00\t00000000\tZ       \t",
        b"00.000 00004000 8 36 47 19 43 01 00 00 80",
        b"1247;RX;0xC2;2;0x5C;0x87",
        b" 0    0CFBFFDB X       8  1B  31  20  EB  B3  FF  D9  FF     100.000139 R",
        b"2011-11-24-22:42:04.388,2,127251,36,255,8,7d,0b,7d,02,00,ff,ff,ff",
        b"17:33:21.107 R 19F51323 01 2F 30 70 00 2F 30 70",
        b"A173321.107 23FF7 1F513 012F3070002F30709F",
    ],
)
def test_lines_of_programs_that_are_not_read_are_taken_for_nothing_else(line: bytes) -> None:
    with pytest.raises(SourceError, match=r"^not a log of a known format"):
        detect(b"\n".join([line] * 30))


@pytest.mark.parametrize(("log_format", "header"), HEADERS.items())
def test_a_header_decides(log_format: LogFormat, header: bytes) -> None:
    found = detect(b"\xef\xbb\xbf" + PROSE + b"\r\n" + header + b"\r\n" + PROSE * 50)
    assert (found.format, found.evidence) == (log_format, "line 2 is its header")


@pytest.mark.parametrize(
    ("probe", "log_format"),
    [
        (b"LOGG" + bytes(200), LogFormat.BLF),
        (b"UnFinMF 4.11", LogFormat.MF4),
        (bytes.fromhex("d4c3b2a102000400000000000000000000000400e3000000"), LogFormat.PCAP),
        (bytes.fromhex("a1b23c4d0002000400000000000000000004000000000071"), LogFormat.PCAP),
        (bytes.fromhex("0a0d0d0a1c0000004d3c2b1a"), LogFormat.PCAPNG),
    ],
)
def test_a_binary_format_names_itself(probe: bytes, log_format: LogFormat) -> None:
    found = detect(probe)
    assert found.format is log_format
    assert found.evidence.startswith("it begins with")


@pytest.mark.parametrize(
    "begin", [b"<!DOCTYPE html>\n<html>", b"\n <!doctype HTML>\n<html>", b"<html>", b"<HTML lang=en>"]
)
def test_a_page_is_named_and_its_styles_are_no_columns(begin: bytes) -> None:
    styles = (
        b"<style>:root { --paper: #fff; --ink: #223; --muted: #567; --rule: #d5d; }\np { a: b; c: d; e: f; g: h; }\n"
    )
    with pytest.raises(SourceError, match="an HTML page") as raised:
        detect(begin + b"\n<head>" + styles * 20)
    assert "--" not in str(raised.value)


@pytest.mark.parametrize("probe", [b"\0", b"\xff\xfe", b"\xfe\xff", b"\r"])
def test_a_file_of_hardly_any_bytes_has_a_clear_error(probe: bytes) -> None:
    assert utf_16_of(probe) in {"", "utf-16-le", "utf-16-be"}
    with pytest.raises(SourceError):
        detect(probe)
