"""Tables of messages: the names of their files."""

from pathlib import PureWindowsPath

from canlog.tables.table_folder import LONGEST_BYTES, file_names

ODD = (
    "Brake",
    "BRAKE",
    "a/b",
    "a:b",
    "..",
    "",
    "con",
    "Lpt1.old",
    "a b*?",
    "Getriebeöl",
    "x" * 300,
    "ö" * 300,
    "\ud800",
)


def test_every_name_is_one_of_a_file_and_of_one_only() -> None:
    names = file_names(ODD)
    assert len({name.casefold() for name in names}) == len(ODD)
    assert (names[0], names[1], names[9]) == ("Brake", "BRAKE-2", "Getriebeöl")
    for name in names:
        assert not set(name) & set('/\\:*?"<>| \0')
        assert 0 < len(name.encode()) <= LONGEST_BYTES + 4
        assert not PureWindowsPath(name).is_reserved()
        assert not name.startswith(".")
        assert name.isprintable()
