"""What a tester knows of a controller: shipped, from a TOML file, from a PDX."""

from importlib.resources import files
from pathlib import Path

import pytest

from diag_service.errors import ConfigError
from tests.tools.tester_description import FILE, written
from workshop.controller.table import shipped_table
from workshop.tester.description import find_description, shipped

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
        ('name = "a"\nrequest_id = -1', "request_id and response_id must be 0"),
        ('name = "a"\n[[data]]\nnumber = 1\nname = "b"\nfields = []', "it needs fields"),
        ('name = "a"\n[[data]]\nnumber = 65536\nname = "b"\nfields = [{name = "c", kind = "text"}]', "0xFFFF"),
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


def test_a_pdx_says_the_same_as_the_table_it_was_made_of() -> None:
    path = Path(str(files("workshop.controller") / "tcu.pdx"))
    from_pdx, from_toml = find_description(path), find_description(Path("dct"))
    assert (from_pdx.request_id, from_pdx.response_id) == (0x7E1, 0x7E9)
    for number, datum in shipped_table().data.items():
        raw = bytes(range(0x30, 0x30 + datum.size_bytes))
        assert from_pdx.size_bytes(number) == datum.size_bytes, datum.name
        assert from_pdx.data_name(number).casefold() == datum.name.casefold()
        values = list(from_pdx.values(number, raw).values())
        assert values == pytest.approx(list(from_toml.values(number, raw).values())), datum.name
    assert from_pdx.trouble_text(0x081107) == from_toml.trouble_text(0x081107) == "Excessive Clutch Slippage"
