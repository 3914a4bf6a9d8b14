"""No two columns are called alike, whatever a database calls its messages and signals."""

from cantools.database.can import Message
from cantools.database.can.signal import Signal

from canlog.decode.codec import message_table
from canlog.tables.layouts import TableNames, table_names


def names(*messages: tuple[str, int, tuple[str, ...]]) -> TableNames:
    """Return the names of some messages, each with its identifier and signals."""
    return table_names(
        [
            message_table(
                Message(
                    can_id,
                    name,
                    8,
                    [Signal(signal, start=8 * place, length=8) for place, signal in enumerate(signals)],
                    is_extended_frame=can_id > 0x7FF,
                    strict=False,
                )
            )
            for name, can_id, signals in messages
        ]
    )


def test_dots_that_make_two_columns_alike() -> None:
    found = names(("A.B", 1, ("C",)), ("A", 2, ("B.C", "D")))
    assert list(found.columns.values()) == ["A.B@0x001.C", "A@0x002.B.C", "A.D"]


def test_in_the_last_resort_there_are_numbers() -> None:
    found = names(("A@0x001", 5, ("X",)), ("A", 1, ("X",)), ("A", 2, ("X",)))
    assert found.messages == ("A@0x001", "A@0x001#2", "A@0x002")
    assert len(set(found.columns.values())) == 3
