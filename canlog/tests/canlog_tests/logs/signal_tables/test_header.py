"""Headers: names, units, sources and addresses in any order of rows, and names that no row has cells for."""

import pytest

from canlog.logs.signal_tables.dialect import Dialect
from canlog.logs.signal_tables.header import known_units, named_header
from canlog.logs.signal_tables.layouts import LAYOUTS, Sheet, vcds

COMMAS = Dialect(separator=",")
NAMES, UNITS = "Time,Engine,Clutch", "s,rpm,bar"
BODY = [f"{row / 10},{800 + row},{row % 5}" for row in range(5)]
HEADERS = {
    "names": ([NAMES], "", 1),
    "units below": ([NAMES, UNITS], UNITS, 2),
    "units above": ([UNITS, NAMES], UNITS, 2),
    "sources below units": ([NAMES, UNITS, "100: gps,200: obd,calc"], UNITS, 3),
    "sources above units": ([NAMES, "100: gps,200: obd,calc", UNITS], UNITS, 3),
    "addresses": ([NAMES, "0x00,0x1F,0x2A", UNITS], UNITS, 3),
    "aliases": (["Time,nmot,p_k1", UNITS, "TIME,EngineSpeed,ClutchPressure"], UNITS, 3),
    "types": ([NAMES, "f8,f8,f8", UNITS], UNITS, 3),
    "units that nobody knows": ([NAMES, "x,y,z"], "x,y,z", 2),
    "descriptions": ([NAMES, UNITS, "the time,the speed of the engine's shaft,pressure of the clutch"], UNITS, 3),
    "words before": (["Car,Golf,red", NAMES, UNITS], UNITS, 3),
}


@pytest.mark.parametrize("name", HEADERS)
def test_rows_of_a_header_are_told_by_what_they_hold(name: str) -> None:
    lines, units, first = HEADERS[name]
    rows = [line.split(",") for line in [*lines, *BODY]]
    found = [header for place in range(len(lines)) if (header := named_header(rows, place, COMMAS)) is not None]
    header = next(header for header in found if header.names[0] == "Time")
    assert header is found[0] or name == "words before"
    assert (",".join(header.units), header.first) == (units, first)
    assert f"line {header.place + 1} names the columns" in header.why


def test_names_without_cells_are_left_out_and_told() -> None:
    rows = [line.split(",") for line in [f"{NAMES},MAP 1.bin", *BODY]]
    header = named_header(rows, 0, COMMAS)
    assert header is not None
    assert header.names == tuple(NAMES.split(","))
    assert header.notes == ("rows have no cells for the last names in the header: MAP 1.bin left out",)


def test_units_are_known_by_their_spelling() -> None:
    assert known_units(["s", "[rpm]", "°C", ""]) == 1.0
    assert known_units(["100: gps", "calc"]) == 0.0


TIMES = {
    "English": ("TIME", "STAMP"), "German": ("Zeit", "MARKE"), "Polish": ("CZAS", "STEMPEL"),
    "unknown stamp": ("ZEIT", "PUNKT"),
}  # fmt: skip


@pytest.mark.parametrize("language", TIMES)
def test_vcds_stacks_its_header_in_any_language(language: str) -> None:
    time, stamp = TIMES[language]
    lines = [
        f"Marker,{time},Loc. 21,{time},Loc. 22,,", f",{stamp},Engine RPM,{stamp},Inj. On Time,,", ",,/min,,ms,,",
        *(f",{row / 10},{800 + row},{row / 10},{300 + row},," for row in range(5)),
    ]  # fmt: skip
    (stated,) = vcds(Sheet(lines=lines, rows=[line.split(",") for line in lines], dialect=COMMAS))
    assert stated.header.names == ("", "time 1", "Engine RPM", "time 2", "Inj. On Time")
    assert stated.header.units == ("", "s", "/min", "s", "ms")
    assert stated.header.clock_places == (1, 3)


def test_two_clocks_over_their_units_are_no_vcds() -> None:
    lines = ["Time,A,Time,B", "sec,bar,sec,bar", "0.0,1,0.0,2"]
    rows = [line.split(",") for line in lines]
    assert not list(vcds(Sheet(lines=lines, rows=rows, dialect=COMMAS)))
    assert LAYOUTS[-1] is not vcds
