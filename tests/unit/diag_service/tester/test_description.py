"""What a tester knows of a controller: shipped, from a TOML file, from a PDX."""

import math
import struct
from pathlib import Path

import pytest

from diag_service.errors import ConfigError
from diag_service.tester.description import UNKNOWN, Coding, Description, Field, read_fields
from diag_service.tester.description_files import find_description, shipped
from ecu_emulator.diagnostics.pdx.package import pdx_package
from ecu_emulator.diagnostics.table_file import shipped_table
from tests.tools.tester_description import FILE, written

OWN = """
name = "gearbox"
request_id = 0x7E1
[[data]]
number = 0x2001
name = "oil"
fields = [
  { name = "warmth", kind = "signed", size_bytes = 2, unit = "K", resolution = 0.1, offset = -40, invalid = -32768 },
  { name = "state", kind = "unsigned", size_bytes = 1, meanings = { "0x00" = "cold", "1" = "warm" } },
  { name = "batch", kind = "text" },
]
[[trouble]]
code = "P0218"
text = "too hot"
"""


def test_the_shipped_description_is_what_the_emulated_controller_has() -> None:
    assert FILE.read_text(encoding="utf-8") == written(shipped_table())
    (described,) = shipped()
    assert set(shipped_table().data) <= set(described.description.data)


def test_a_number_that_is_none_is_not_available() -> None:
    found = Description(name="a", readers={1: lambda _: {"x": float("nan"), "y": float("-inf"), "z": 1.5, "t": "inf"}})
    assert found.values(1, b"") == {"x": None, "y": None, "z": 1.5, "t": "inf"}
    large = Field(name="x", kind=Coding.UNSIGNED, size_bytes=8, resolution=1e300)
    assert read_fields((large,), b"\xff" * 8) == {"x": None}


def test_a_file_of_ones_own_says_what_bytes_mean(tmp_path: Path) -> None:
    path = tmp_path / "gearbox.toml"
    path.write_text(OWN, encoding="utf-8")
    found = find_description(path)
    assert found.values(0x2001, bytes.fromhex("0384 01 4142 00")) == {
        "warmth [K]": 50.0, "state": "warm", "batch": "AB",
    }  # fmt: skip
    assert found.values(0x2001, bytes.fromhex("8000 07")) == {"warmth [K]": None, "state": 7, "batch": ""}
    assert found.values(0xF190, b"VIN") == {"vehicle identification number": "VIN"}
    assert found.values(0x1234, b"\x01\xff") == {"": "01 FF"}
    assert found.find_data("OIL") == found.find_data("2001") == found.find_data("0x2001") == 0x2001
    assert found.trouble_text(0x021800) == "too hot"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("x = 1", "x is unknown"),
        ("name = 3", "name must be a string, got 3"),
        ('name = "a"\nrequest_id = -1', "request_id and response_id must be 0"),
        ('name = "a"\n[[data]]\nnumber = 1\nname = "b"\nfields = []', "it needs fields"),
        ('name = "a"\n[[data]]\nnumber = 65536\nname = "b"\nfields = [{name = "c", kind = "text"}]', "0xFFFF"),
        (
            'name = "a"\n[[data]]\nnumber = 1\nname = "b"\nfields = [{name = "c", kind = "complex"}]',
            "kind must be one of",
        ),
        ('name = "a"\n[[data]]\nnumber = 1\nname = "b"\nfields = [{name = "c", kind = "signed"}]', "size_bytes 0"),
        ('name = "a"\n[[trouble]]\ncode = "X1"\ntext = ""', "trouble code X1 is none"),
        ("name = ", "is not TOML"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "x.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=complaint) as refused:
        find_description(path)
    assert "\n" not in str(refused.value)


def test_a_number_twice_is_named(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    datum = '[[data]]\nnumber = 1\nname = "b"\nfields = [{name = "c", kind = "text"}]\n'
    path.write_text(f'name = "a"\n{datum}{datum}', encoding="utf-8")
    with pytest.raises(ConfigError, match="data 0x0001 is there twice"):
        find_description(path)


def test_a_name_that_ships_not_lists_those_that_do() -> None:
    assert find_description(None) is UNKNOWN
    assert find_description(Path("dct")).name == "TCU"
    with pytest.raises(ConfigError, match=r"no controller nothing: give a .toml or .pdx file or one of dct"):
        find_description(Path("nothing"))
    with pytest.raises(ConfigError, match=r"cannot read the description missing\.toml"):
        find_description(Path("missing.toml"))


def test_a_word_that_is_no_datum_is_refused_with_what_there_is() -> None:
    with pytest.raises(
        ConfigError,
        match=r"'oil' is not a datum: give its number in hexadecimal or its name.* has .*vehicle identification number",
    ):
        UNKNOWN.find_data("oil")


def test_what_is_left_of_bytes_is_shown() -> None:
    entry = Field(name="a", kind=Coding.UNSIGNED, size_bytes=1)
    assert read_fields((entry,), b"\1\2") == {"a": 1, "more bytes": "02"}
    assert read_fields((entry, entry), b"") == {}


def test_a_float_keeps_every_bit_and_what_is_none_is_not_available() -> None:
    wide, narrow = (Field(name=name, kind=Coding.FLOAT, size_bytes=size) for name, size in (("a", 8), ("b", 4)))
    data = struct.pack(">df", 0.1 + 0.2, 0.5)
    assert read_fields((wide, narrow), data) == {"a": 0.1 + 0.2, "b": 0.5}
    assert read_fields((wide, narrow), struct.pack(">df", math.nan, math.inf)) == {"a": None, "b": None}
    with pytest.raises(ConfigError, match="size_bytes 2 is not usable: a float has 4 or 8"):
        Field(name="c", kind=Coding.FLOAT, size_bytes=2)


def test_a_pdx_says_the_same_as_the_table_it_was_made_of(tmp_path: Path) -> None:
    path = tmp_path / "tcu.pdx"
    path.write_bytes(pdx_package(shipped_table()))
    from_pdx, from_toml = find_description(path), find_description(Path("dct"))
    assert (from_pdx.request_id, from_pdx.response_id) == (0x7E1, 0x7E9)
    for number, datum in shipped_table().data.items():
        raw = bytes(range(0x30, 0x30 + datum.size_bytes))
        assert from_pdx.size_bytes(number) == datum.size_bytes, datum.name
        assert from_pdx.data_name(number).casefold() == datum.name.casefold()
        values = list(from_pdx.values(number, raw).values())
        assert values == pytest.approx(list(from_toml.values(number, raw).values())), datum.name
    assert from_pdx.trouble_text(0x081107) == from_toml.trouble_text(0x081107) == "Excessive Clutch Slippage"


def _part(kind: str, name: str, place: int, more: str) -> str:
    head = f'<PARAM xsi:type="{kind}"><SHORT-NAME>{name}</SHORT-NAME><BYTE-POSITION>{place}</BYTE-POSITION>'
    return f"{head}{more}</PARAM>"


def _coded(bits: int) -> str:
    kind = 'BASE-DATA-TYPE="A_UINT32" xsi:type="STANDARD-LENGTH-TYPE"'
    return f"<DIAG-CODED-TYPE {kind}><BIT-LENGTH>{bits}</BIT-LENGTH></DIAG-CODED-TYPE>"


WHEELS = f"""<ODX MODEL-VERSION="2.2.0" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">
<DIAG-LAYER-CONTAINER ID="C"><SHORT-NAME>C</SHORT-NAME>
<BASE-VARIANTS><BASE-VARIANT ID="B"><SHORT-NAME>B</SHORT-NAME><DIAG-DATA-DICTIONARY-SPEC>
<DATA-OBJECT-PROPS><DATA-OBJECT-PROP ID="D"><SHORT-NAME>d</SHORT-NAME>
<COMPU-METHOD><CATEGORY>IDENTICAL</CATEGORY></COMPU-METHOD>{_coded(8)}<PHYSICAL-TYPE BASE-DATA-TYPE="A_UINT32"/>
</DATA-OBJECT-PROP></DATA-OBJECT-PROPS><STRUCTURES><STRUCTURE ID="S"><SHORT-NAME>wheel</SHORT-NAME><PARAMS>
{_part("VALUE", "speed", 0, '<DOP-REF ID-REF="D"/>')}</PARAMS></STRUCTURE></STRUCTURES>
<END-OF-PDU-FIELDS><END-OF-PDU-FIELD ID="E"><SHORT-NAME>wheels</SHORT-NAME><BASIC-STRUCTURE-REF ID-REF="S"/>
</END-OF-PDU-FIELD></END-OF-PDU-FIELDS></DIAG-DATA-DICTIONARY-SPEC><DIAG-COMMS><DIAG-SERVICE ID="V">
<SHORT-NAME>Read_wheels</SHORT-NAME><REQUEST-REF ID-REF="Q"/><POS-RESPONSE-REFS><POS-RESPONSE-REF ID-REF="R"/>
</POS-RESPONSE-REFS></DIAG-SERVICE></DIAG-COMMS><REQUESTS><REQUEST ID="Q"><SHORT-NAME>q</SHORT-NAME><PARAMS>
{_part("CODED-CONST", "sid", 0, f"<CODED-VALUE>34</CODED-VALUE>{_coded(8)}")}
{_part("CODED-CONST", "did", 1, f"<CODED-VALUE>8192</CODED-VALUE>{_coded(16)}")}
</PARAMS></REQUEST></REQUESTS><POS-RESPONSES><POS-RESPONSE ID="R"><SHORT-NAME>r</SHORT-NAME><PARAMS>
{_part("CODED-CONST", "sid", 0, f"<CODED-VALUE>98</CODED-VALUE>{_coded(8)}")}
{_part("CODED-CONST", "did", 1, f"<CODED-VALUE>8192</CODED-VALUE>{_coded(16)}")}
{_part("VALUE", "state", 3, '<DOP-REF ID-REF="D"/>')}{_part("VALUE", "spare", 4, '<DOP-REF ID-REF="S"/>')}
{_part("VALUE", "wheels", 5, '<DOP-REF ID-REF="E"/>')}</PARAMS></POS-RESPONSE></POS-RESPONSES>
</BASE-VARIANT></BASE-VARIANTS></DIAG-LAYER-CONTAINER></ODX>"""


def test_values_of_one_name_in_an_odx_file_are_all_told(tmp_path: Path) -> None:
    path = tmp_path / "x.odx-d"
    path.write_text(WHEELS, encoding="utf-8")
    values = find_description(path).values(0x2000, bytes([1, 2, 3, 4]))
    assert values == {"state": 1, "spare speed": 2, "wheels 1 speed": 3, "wheels 2 speed": 4}


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 no zip", b"<ODX/>"])
def test_what_is_no_pdx_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.pdx"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"x\.pdx"):
        find_description(path)
    with pytest.raises(ConfigError, match=r"cannot read .*missing\.pdx"):
        find_description(tmp_path / "missing.pdx")
