"""What a Parquet file says of itself: columns and their types, where pages are and what is in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from canlog.parquet.compact import BINARY, I32, I64, LIST, STRUCT, TRUE, Field, binary, integer, listed, struct, text

MAGIC: Final = b"PAR1"
VERSION: Final = 2
OPTIONAL: Final = 1
DATA_PAGE, DICTIONARY_PAGE = 0, 2
PLAIN, RLE, DIFFERENCES, DICTIONARY = 0, 3, 5, 8  # encodings
ZSTD: Final = 6


_RLE: Final = integer(RLE)
_ENCODINGS: Final = {
    (one, has_entries): listed(I32, [integer(each) for each in sorted({one, RLE, *((PLAIN,) if has_entries else ())})])
    for one in (PLAIN, DIFFERENCES, DICTIONARY)
    for has_entries in (False, True)
}  # of the values and of what is beside them, as a chunk names them


class Physical(IntEnum):
    """How the values of a column are stored."""

    BOOLEAN = 0
    INT32 = 1
    INT64 = 2
    DOUBLE = 5
    TEXT = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnType:
    """What a column holds; ``is_time`` are nanoseconds of UTC."""

    physical: Physical
    is_time: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ChunkFacts:
    """The pages of one column in one group of rows."""

    encoding: int  # of the values
    row_count: int
    null_count: int
    unpacked_bytes: int
    packed_bytes: int
    data_at: int  # place of the first data page in the file
    dictionary_at: int | None
    limits: tuple[bytes | None, bytes | None]  # lowest and highest value, as the column stores values


def schema(columns: Mapping[str, ColumnType]) -> bytes:
    """Return the list of columns, all of which may have nulls."""
    root = struct((4, BINARY, text("schema")), (5, I32, integer(len(columns))))
    return listed(STRUCT, [root, *(_column(name, kind) for name, kind in columns.items())])


def _column(name: str, kind: ColumnType) -> bytes:
    fields: list[Field] = [
        (1, I32, integer(kind.physical)),
        (3, I32, integer(OPTIONAL)),
        (4, BINARY, text(name)),
    ]
    if kind.physical is Physical.TEXT:
        fields += [(6, I32, integer(0)), (10, STRUCT, struct((1, STRUCT, struct())))]
    if kind.is_time:
        nanoseconds = struct((3, STRUCT, struct()))
        fields += [(10, STRUCT, struct((8, STRUCT, struct((1, TRUE, b""), (2, STRUCT, nanoseconds)))))]
    return struct(*fields)


def data_page_header(row_count: int, encoding: int, unpacked_bytes: int, packed_bytes: int) -> bytes:
    """Return the header of a page of values, with its rows that are null."""
    levels = ((3, I32, _RLE), (4, I32, _RLE))
    counts = struct((1, I32, integer(row_count)), (2, I32, integer(encoding)), *levels)
    return _page_header(DATA_PAGE, unpacked_bytes, packed_bytes, (5, STRUCT, counts))


def dictionary_page_header(value_count: int, unpacked_bytes: int, packed_bytes: int) -> bytes:
    """Return the header of the page with the different values of a column."""
    counts = struct((1, I32, integer(value_count)), (2, I32, integer(PLAIN)))
    return _page_header(DICTIONARY_PAGE, unpacked_bytes, packed_bytes, (7, STRUCT, counts))


def _page_header(kind: int, unpacked_bytes: int, packed_bytes: int, more: Field) -> bytes:
    sizes = ((2, I32, integer(unpacked_bytes)), (3, I32, integer(packed_bytes)))
    return struct((1, I32, integer(kind)), *sizes, more)


def chunk(name: str, kind: ColumnType, facts: ChunkFacts) -> bytes:
    """Return what is to be known of one column in one group of rows."""
    fields: list[Field] = [
        (1, I32, integer(kind.physical)),
        (2, LIST, _ENCODINGS[facts.encoding, facts.dictionary_at is not None]),
        (3, LIST, listed(BINARY, [text(name)])),
        (4, I32, integer(ZSTD)),
        (5, I64, integer(facts.row_count)),
        (6, I64, integer(facts.unpacked_bytes)),
        (7, I64, integer(facts.packed_bytes)),
        (9, I64, integer(facts.data_at)),
    ]
    if facts.dictionary_at is not None:
        fields.append((11, I64, integer(facts.dictionary_at)))
    fields.append((12, STRUCT, _statistics(facts)))
    first_at = facts.data_at if facts.dictionary_at is None else facts.dictionary_at
    return struct((2, I64, integer(first_at)), (3, STRUCT, struct(*fields)))


def _statistics(facts: ChunkFacts) -> bytes:
    fields: list[Field] = [(3, I64, integer(facts.null_count))]
    lowest, highest = facts.limits
    if lowest is not None and highest is not None:
        fields += [(5, BINARY, binary(highest)), (6, BINARY, binary(lowest))]
    return struct(*fields)


def row_group(chunks: Sequence[bytes], unpacked_bytes: int, row_count: int) -> bytes:
    """Return what is to be known of one group of rows."""
    return struct((1, LIST, listed(STRUCT, chunks)), (2, I64, integer(unpacked_bytes)), (3, I64, integer(row_count)))


def footer(
    columns: Mapping[str, ColumnType],
    groups: Sequence[bytes],
    row_count: int,
    more: Mapping[str, str],
    maker: str,
) -> bytes:
    """Return what stands at the end of the file; ``more`` is told to whoever asks for it by name."""
    pairs = [struct((1, BINARY, text(key)), (2, BINARY, text(value))) for key, value in more.items()]
    by_type = struct((1, STRUCT, struct()))  # values are ordered as their type says: needed for lowest and highest
    fields = struct(
        (1, I32, integer(VERSION)),
        (2, LIST, schema(columns)),
        (3, I64, integer(row_count)),
        (4, LIST, listed(STRUCT, groups)),
        (5, LIST, listed(STRUCT, pairs)),
        (6, BINARY, text(maker)),
        (7, LIST, listed(STRUCT, [by_type] * len(columns))),
    )
    return fields + len(fields).to_bytes(4, "little") + MAGIC
