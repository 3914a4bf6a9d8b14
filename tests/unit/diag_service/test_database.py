"""Databases of other people: good ones load, bad ones are refused with one clear line and without harm."""

import logging
from pathlib import Path

import pytest

from dbc.contract import DBC_PATH
from diag_service.database import MAX_FILE_BYTES, load_database
from diag_service.errors import ConfigError

HEAD = 'VERSION ""\nBU_: A\n'
SIGNAL = 'BO_ 256 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n'


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "some.dbc"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refusal(path: Path) -> str:
    with pytest.raises(ConfigError) as refused:
        load_database(path)
    text = str(refused.value)
    assert "\n" not in text
    assert len(text) < 400
    return text


def test_own_database_loads_without_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        assert len(load_database(DBC_PATH).messages) == 10
    assert not caplog.records


def test_database_that_breaks_strict_rules_loads_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write(tmp_path, HEAD + SIGNAL + ' SG_ t : 4|8@1+ (1,0) [0|0] "" A\n')
    with caplog.at_level(logging.WARNING, logger="diag_service"):
        database = load_database(path)
    assert [signal.name for signal in database.messages[0].signals] == ["s", "t"]
    assert "overlapping" in caplog.text


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_units_survive_any_usual_encoding(tmp_path: Path, encoding: str) -> None:
    text = HEAD + 'BO_ 256 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "°C" A\n'
    database = load_database(write(tmp_path, text.encode(encoding)))
    assert database.messages[0].signals[0].unit == "°C"


def test_missing_file_and_folder(tmp_path: Path) -> None:
    assert "No such file" in refusal(tmp_path / "absent.dbc")
    assert "directory" in refusal(tmp_path)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"hello, world",
        b"\x7fELF\x02\x01\x01" + bytes(range(256)),
        b'<?xml version="1.0"?><a/>',
        b"(0.1) can0 1#00\n",
    ],
)
def test_other_content_is_refused(tmp_path: Path, content: bytes) -> None:
    assert "not a DBC file" in refusal(write(tmp_path, content))


@pytest.mark.parametrize(
    "text",
    [
        HEAD + 'BO_ 256 M: 8 A\n SG_ s : 0|8@1+ (x,0) [0|0] "" A\n',
        HEAD + SIGNAL + 'BA_ "Undefined" BO_ 256 1;\n',
        HEAD + SIGNAL + 'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10;\nBA_ "GenMsgCycleTime" BO_ 256 abc;\n',
        HEAD + 'BO_ 99999999999 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n',
        HEAD + 'BO_ 256 M: 8 A\n SG_ s : 0|0@1+ (1,0) [0|0] "" A\n',
    ],
)
def test_damaged_database_is_refused(tmp_path: Path, text: str) -> None:
    assert "not a DBC file" in refusal(write(tmp_path, text))


@pytest.mark.parametrize(
    "text",
    [
        'BO_ 1 m: 8 A\n SG_ s : 0|4000000000@1+ (1,0) [0|0] "" A\n',
        'BO_ 1 m: 8 A\n SG_ s : 4000000000|8@1+ (1,0) [0|0] "" A\n',
        "BO_ 1 m: 8 A\n SG_ s\n:\n0 | " + "9" * 5000 + ' @ 1+ (1,0) [0|0] "" A\n',
        'BO_ 1 m: 4000000000 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n',
        "BO_ 1 m:\n" + "9" * 5000 + ' A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n',
        'BO_ 1 m: 8 A\n SG_ p M : 0|8@1+ (1,0) [0|0] "" A\nSG_MUL_VAL_ 1 s p 0-4000000000;\n',
    ],
)
def test_sizes_that_would_fill_the_memory_are_refused(tmp_path: Path, text: str) -> None:
    assert any(words in refusal(write(tmp_path, HEAD + text)) for words in ("not a CAN", "any CAN", "too wide"))


def test_sizes_inside_texts_are_harmless(tmp_path: Path) -> None:
    path = write(tmp_path, HEAD + SIGNAL + 'CM_ SG_ 256 s "was SG_ s : 0|4000000000@1+, \\"quoted\\"";\n')
    assert load_database(path).messages[0].name == "M"


def test_huge_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "huge.dbc"
    with path.open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)
    assert "too large" in refusal(path)
