"""Databases of other people, DBC, KCD, ARXML and SYM, by cantools; what it would misread is left out or refused."""

import logging
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import cantools
from cantools.database.can import Database, Message

from canlog.database.addressing import J1939, is_of_groups
from canlog.database.dbc_imports import with_imports
from canlog.database.dbc_text import (
    EXTENDED,
    Edit,
    edited,
    left_out_at,
    line_number,
    message_count,
    outside_grammar,
    plain_of,
    signals_left_out,
    with_pages,
    without_meaning,
)
from canlog.errors import NOTICE, DefinitionError
from canlog.files import is_there, read_small_file

if TYPE_CHECKING:
    from cantools.database.can.signal import Signal


MAX_BITS: Final = 8 * 1785  # longest J1939 transport message, far above any CAN frame
MAX_MULTIPLEXED: Final = 1_000_000  # values of multiplexers in a file, each of which the parser writes out
MAX_DIGITS: Final = 9  # no number that sizes something needs more
FLOAT_BITS: Final = frozenset({16, 32, 64})
# Of messages in bytes, of signals the place in bits; the possessive ones look at no character twice.
_SIZES: Final = {
    "dbc": re.compile(
        r"\bBO_\s++\d++\s++\w++\s*+:\s*+(?P<bytes>\d++)|(?<!\d)(?P<start>\d++)\s*+\|\s*+(?P<bits>\d++)\s*+@"
    ),
    "kcd": re.compile(r"\b(?:length|offset)\s*+=\s*+[\"'](?P<bits>\d++)"),  # a length is of either
    "sym": re.compile(r"\bLen\s*+=\s*+(?P<bytes>\d++)|[A-Za-z]\s++(?P<start>\d++),(?P<bits>\d++)"),
    "arxml": re.compile(r"(?:LENGTH|START-POSITION)>\s*+(?P<bits>\d++)"),
}
_RANGE: Final = re.compile(r"(?<!\d)(\d++)\s*+-\s*+(\d++)")
_ITEM: Final = re.compile(
    r"(?<!\S)(?:BO_\s++(?P<message>\d++)\s|SG_\s++(?P<signal>\w++)(?:\s++(?P<mark>[\w-]++))?+\s*+:"
    r"|SG_MUL_VAL_\s++(?P<paged>\d++)\s++(?P<page>\w++)\s++(?P<multiplexer>\w++)(?P<ranges>[^;]*+)"
    r"|SIG_VALTYPE_\s++(?P<typed>\d++)\s++(?P<of_type>\w++)\s*+:\s*+(?P<type>\d++))"
)


def line_of(text: str, position: int) -> str:
    return f"line {line_number(text, position)}"


def oversized(text: str, database_format: str) -> Iterator[tuple[int, str]]:
    """Yield place and cause of sizes that would make the parser fill the memory, before it sees them."""
    for match in _SIZES[database_format].finditer(text):
        size = {name: _number(digits) for name, digits in match.groupdict(default="0").items()}
        if max(8 * size.get("bytes", 0), size.get("start", 0) + size["bits"]) > MAX_BITS:
            yield match.start(), f"{match[0][:60]}: no CAN message is so long"


def check_ranges(plain: str) -> None:
    """Raise DefinitionError for more values of multiplexers than the parser can write out."""
    ranges = [_RANGE.findall(item["ranges"] or "") for item in _ITEM.finditer(plain)]
    if sum(_number(last) - _number(first) for pairs in ranges for first, last in pairs) > MAX_MULTIPLEXED:
        raise DefinitionError("the ranges of SG_MUL_VAL_ are wider than those of any multiplexer")


def _number(digits: str) -> int:
    """Return a decimal number, or a billion if it has more digits than any size needs."""
    return int(digits) if len(digits) <= MAX_DIGITS else 10**MAX_DIGITS


def misread_signals(plain: str, database: Database) -> Iterator[tuple[int, str, str]]:
    """Yield message number, name and cause of signals that cannot be right in a database that cantools took.

    ``plain`` is the text of a DBC file with blanks in its quotes, empty for other formats.
    """
    signals: dict[int, dict[str, Signal]] = {}
    for message in database.messages:
        number = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        signals.setdefault(number, {}).update((signal.name, signal) for signal in message.signals)
        yield from _misread_in(message, number)
    number = 0
    for match in _ITEM.finditer(plain):
        number, cause = int(match["message"] or number), ""
        owner, name = (
            int(match["paged"] or match["typed"] or number),
            match["signal"] or match["page"] or match["of_type"],
        )
        signal = signals.get(owner, {}).get(name or "")
        if signal is not None and match["mark"] not in {None, "M"} and not signal.multiplexer_ids:
            cause = f"signal {name}: nothing says which multiplexer (M) of its message selects it"
        elif signal is not None and match["page"] and signal.multiplexer_signal != match["multiplexer"]:
            cause = f"SG_MUL_VAL_ of {name}: its message has no multiplexer {match['multiplexer']}"
        elif match["type"] not in {None, "0", "1", "2"}:
            cause = f"signal {name}: SIG_VALTYPE_ has no type {match['type']}"
        if cause:
            yield owner, name, cause


def _misread_in(message: Message, number: int) -> Iterator[tuple[int, str, str]]:
    pages = Counter((signal.name, str(signal.multiplexer_ids)) for signal in message.signals)
    for name in (name for (name, _), count in pages.items() if count > 1):
        yield number, name, f"message {message.name} has another signal {name}"
    for signal in message.signals:
        if signal.is_float and signal.length not in FLOAT_BITS:
            cause = f"signal {signal.name} of message {message.name} is a float of {signal.length} bits"
            yield number, signal.name, cause
    for contained in message.contained_messages or ():
        yield from _misread_in(contained, number)


MAX_FILE_BYTES: Final = 16 * 2**20  # the largest public ones have 5 MB; parsing takes up to 70 times the memory
MAX_WARNINGS: Final = 20
HEAD_CHARACTERS: Final = 65_536  # from the first on, that tell the format

_LOG: Final = logging.getLogger(__name__)
_SYM: Final = re.compile(r"((?:\s|//[^\n]*\n)*)FormatVersion\s*=")  # comments may stand before it
_ROOT: Final = re.compile(r"<(?:[\w.-]+:)?([A-Za-z_][\w.-]*)[\s/>]")
_BUS_MARK: Final = "#"
_NARROW_BYTES: Final = 64  # looked at for UTF-16 without a byte-order mark
_BYTE_ORDER_MARKS: Final = (b"\xff\xfe", b"\xfe\xff")  # of UTF-16
_SYNTAX: Final = re.compile(r"Invalid syntax at line \d+, column (?P<column>\d+): (?P<text>.*)")
MAX_ROUNDS: Final = 16  # of parsing; each leaves out all that it finds, but for quotes that nothing closes
MAX_QUOTED: Final = 80  # characters of a line
_VALUE: Final = re.compile(r"'[^']{1,80}'$")
_MESSAGE: Final = re.compile(r"in message (\w+)\.?$")


class DatabaseFormat(StrEnum):
    """The formats that can be read, as cantools names them."""

    DBC = "dbc"
    KCD = "kcd"
    ARXML = "arxml"
    SYM = "sym"

    @property
    def in_words(self) -> str:
        return f"{'an' if self is DatabaseFormat.ARXML else 'a'} {self.name} file"


_FORMAT_OF_ROOT: Final = {"NetworkDefinition": DatabaseFormat.KCD, "AUTOSAR": DatabaseFormat.ARXML}


@dataclass(frozen=True, slots=True, kw_only=True)
class DatabaseFile:
    """The text of a database and where it came from."""

    file: Path
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Loaded:
    """What a loader made of a text, and what of it was left out or read otherwise than it stands, with lines."""

    database: Database
    notices: Sequence[str] = ()


def load_database(path: Path | str, *, is_j1939: bool = False) -> Database:
    """Return the messages of a DBC, KCD, ARXML or SYM file; which one it is, its contents say.

    Of a DBC, a line that cannot be read costs what it says: it is left out and warned of with its line, and so is an
    identifier or a multiplexer whose mark is missing and read as if it were there. Signals that overlap or lie outside
    their message are warned of, message by message; whether signals in use are sound is checked when they are mapped.

    Parameters
    ----------
    path : Path or str
        The file; of a network of several buses, ``FILE#BUS`` is one of them.
    is_j1939 : bool
        Match all 29-bit identifiers by their parameter group (J1939, NMEA 2000), whatever the database says. Without,
        that is done if it says nothing and the sender of all of them is the null address, which no sender has.

    Raises
    ------
    DefinitionError
        If the file is missing, unreadable or of another format, if less than half of its messages can be read or no
        signal, or if what is not a DBC has an item that cannot be right or a size that no CAN message has.
    """
    file, bus = bus_of(Path(path))
    loaded = read_database(file)
    _warn_each(file, loaded.notices)
    database = loaded.database
    complaints = [complaint for message in database.messages for complaint in _complaints_of(message)]
    _warn_each(file, [f"does not load strictly: {complaint}" for complaint in complaints])
    chosen = _chosen_messages(database, bus, file)
    long = [message for message in chosen.messages if message.is_extended_frame]
    protocol = chosen.dbc.attributes.get("ProtocolType") if chosen.dbc else None
    if not is_j1939 and is_of_groups(long, str(protocol.value) if protocol else ""):
        _LOG.log(
            NOTICE, "%s: %d messages are matched by their parameter groups (PGN), as J1939 has it", file, len(long)
        )
        is_j1939 = True
    for message in long if is_j1939 else ():
        message.protocol = J1939
    return chosen


def read_database(file: Path) -> Loaded:
    """Return the messages of a file, and all that was left out of it or mended; raises as ``load_database``."""
    text = _read_text(file)
    database_format = _format_of(text, file)
    try:
        loaded = _LOADERS[database_format](DatabaseFile(file=file, text=text))
    except (cantools.Error, DefinitionError) as error:
        raise DefinitionError(f"{file} is not {database_format.in_words}: {_reason(error, text)}") from error
    if not loaded.database.messages:
        raise DefinitionError(f"{file} is not {database_format.in_words}, or it has no messages")
    return loaded


def _load_whole(source: DatabaseFile, database_format: DatabaseFormat) -> Loaded:
    """Return a database that is taken as a whole or not at all; raises cantools.Error and DefinitionError."""
    for place, cause in oversized(source.text, database_format):
        raise DefinitionError(f"{line_of(source.text, place)}: {cause}")
    database = _parsed(source.text, database_format)
    for _, _, cause in misread_signals("", database):
        raise DefinitionError(f"it would be misread: {cause}")
    return Loaded(database=database)


def _load_sym(source: DatabaseFile) -> Loaded:
    text = source.text
    if begin := _SYM.match(text):
        text = "\n" * begin[1].count("\n") + text[begin.end(1) :]  # cantools takes no such comments
    return _load_whole(replace(source, text=text), DatabaseFormat.SYM)


def _load_dbc(source: DatabaseFile) -> Loaded:
    """Return what can be read of a DBC; raises cantools.Error and DefinitionError where that is next to nothing."""
    combined = with_imports(source.file, source.text, _read_text)
    text, causes = combined.text, list[tuple[int, str]]()
    message_lines = message_count(text)
    if not message_lines:
        return Loaded(database=_parsed(text, DatabaseFormat.DBC))
    for _ in range(MAX_ROUNDS):
        database, edits = _round(text)
        if not edits:
            break
        text, round_causes = edited(text, with_pages(text, edits))
        causes += round_causes
    else:
        raise DefinitionError(f"{MAX_ROUNDS} times there was another line that cannot be read")
    notices = [*combined.notices, *(f"{combined.place(line)}: {cause}" for line, cause in sorted(causes))]
    read_count = message_count(text)
    if causes and (2 * read_count < message_lines or not any(message.signals for message in database.messages)):
        raise DefinitionError(f"{read_count} of {message_lines} messages can be read; {notices[-len(causes)]}")
    return Loaded(database=database, notices=notices)


def _round(text: str) -> tuple[Database, list[Edit]]:
    """Return the database of a text, and what to leave out of it or to mend before that is right."""
    plain = plain_of(text)
    check_ranges(plain)
    if edits := left_out_at(text, oversized(plain, DatabaseFormat.DBC)):
        return Database(), edits
    try:
        database = _parsed(text, DatabaseFormat.DBC)
    except cantools.Error as error:
        edits = outside_grammar(text, _syntax_error) if _syntax_error_of(error) else without_meaning(text)
        if not edits:
            raise
        return Database(), edits
    wrong = list(misread_signals(plain, database))
    edits = without_meaning(text) or signals_left_out(text, wrong)
    if wrong and not edits:
        raise DefinitionError(f"it would be misread: {wrong[0][-1]}")
    return database, edits


def _parsed(text: str, database_format: DatabaseFormat) -> Database:
    database = cantools.database.load_string(text, database_format=database_format, strict=False)
    if not isinstance(database, Database):
        raise cantools.Error("it holds no CAN messages")
    return database


def _syntax_error(text: str) -> str:
    """Return where the grammar of DBC ends in a text, empty if that is nowhere."""
    try:
        _parsed(text, DatabaseFormat.DBC)
    except cantools.Error as error:
        return _syntax_error_of(error)
    return ""


def _syntax_error_of(error: Exception) -> str:
    """Return column and text of a syntax error, empty if it is another one."""
    match = _SYNTAX.search(" ".join(str(error.__cause__ or error).split()))
    if match is None:
        return ""
    text = match["text"] if len(match["text"]) <= MAX_QUOTED else f"{match['text'][:MAX_QUOTED]}..."
    return f"invalid syntax at column {match['column']}: {text}"


_LOADERS: Final[dict[DatabaseFormat, Callable[[DatabaseFile], Loaded]]] = {
    DatabaseFormat.DBC: _load_dbc,
    DatabaseFormat.SYM: _load_sym,
    DatabaseFormat.KCD: partial(_load_whole, database_format=DatabaseFormat.KCD),
    DatabaseFormat.ARXML: partial(_load_whole, database_format=DatabaseFormat.ARXML),
}


def _reason(error: Exception, text: str) -> str:
    """Return what is wrong, with its line where that is known, in at most 160 characters."""
    cause = error.__cause__ or error
    reason, place = " ".join(str(cause).split()) or type(cause).__name__, ""
    if isinstance(cause, KeyError):
        reason, place = f"{reason} is not defined", f'"{re.escape(str(cause.args[0]))}"'
    elif message := _MESSAGE.search(reason):
        place = rf"\bBO_\s+\d+\s+{message[1]}\s*:"
    elif isinstance(cause, ValueError) and (value := _VALUE.search(reason)):
        reason, place = f"{value[0]} stands where a number has to be", re.escape(value[0][1:-1])
    elif isinstance(cause, AttributeError | LookupError | TypeError):  # of cantools, at something unforeseen
        reason = "something that it needs is missing"
    matches = list(re.finditer(place, text)) if place else []
    if matches and (len(matches) == 1 or not isinstance(cause, ValueError)):
        reason = f"{line_of(text, matches[0].start())}: {reason}"
    return reason if len(reason) <= 160 else f"{reason[:157]}..."


def _complaints_of(message: Message) -> list[str]:
    """Return what the strict check complains of in a message and those it contains."""
    complaints = []
    try:
        message.refresh(strict=True)
    except cantools.Error as error:
        complaints.append(" ".join(str(error).split()))
    for contained in message.contained_messages or ():
        complaints += _complaints_of(contained)
    return complaints


def _warn_each(path: Path, texts: Sequence[str]) -> None:
    """Warn of the first of many things, and say how many more there are."""
    for text in texts[:MAX_WARNINGS]:
        _LOG.warning("%s: %s", path, text)
    if len(texts) > MAX_WARNINGS:
        _LOG.warning("%s: and %d more like these", path, len(texts) - MAX_WARNINGS)


def _read_text(path: Path) -> str:
    """Return the text of the file; DBC files come in UTF-8 and in the Windows code page."""
    try:
        content = read_small_file(path, MAX_FILE_BYTES)
    except OSError as error:
        raise DefinitionError(f"cannot read the database {path}: {error.strerror or error}") from error
    text = _decoded(content).rstrip("\x00\x1a")  # how files of old ended
    return text.replace("\r\n", "\n").replace("\r", "\n") + "\n"


def _decoded(content: bytes) -> str:
    if content.startswith(_BYTE_ORDER_MARKS):
        return content.decode("utf-16", errors="replace")
    if content[:_NARROW_BYTES].count(0) * 3 > len(content[:_NARROW_BYTES]):  # every other byte, as a rule
        return content.decode("utf-16-le" if content[1:2] == b"\0" else "utf-16-be", errors="replace")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def _format_of(text: str, path: Path) -> DatabaseFormat:
    """Return the format of a text: DBC unless it begins as another format does."""
    head = text[:HEAD_CHARACTERS].lstrip()
    if _SYM.match(text):
        return DatabaseFormat.SYM
    if not head.startswith("<"):
        return DatabaseFormat.DBC
    root = _ROOT.search(head)
    if root is None or root[1] not in _FORMAT_OF_ROOT:
        raise DefinitionError(f"{path} is neither a DBC file nor a KCD or ARXML file")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise DefinitionError(f"{path} defines a document type or entities, which no {root[1]} file needs")
    return _FORMAT_OF_ROOT[root[1]]


def bus_of(path: Path) -> tuple[Path, str]:
    """Return the file and the bus that ``FILE#BUS`` names; without a bus, or if there is such a file, no bus."""
    name, mark, bus = path.name.rpartition(_BUS_MARK)
    if not mark or not name or is_there(path):
        return path, ""
    return path.with_name(name), bus


def _chosen_messages(database: Database, bus: str, path: Path) -> Database:
    """Return a database with the messages of a bus, or of all.

    Raises DefinitionError if there is no such bus, or two buses use one identifier and none of them was named.
    """
    buses = list(dict.fromkeys(message.bus_name for message in database.messages if message.bus_name))
    if bus and bus not in buses:
        raise DefinitionError(f"{path} has no bus {bus!r}; it has {', '.join(buses) or 'none by name'}")
    wanted = [message for message in database.messages if not bus or message.bus_name == bus]
    first: dict[tuple[int, bool], Message] = {}
    for message in wanted:
        other = first.setdefault((message.frame_id, message.is_extended_frame), message)
        if other is not message:
            places = (
                f"{owner.name} of {owner.bus_name}" if owner.bus_name else owner.name for owner in (other, message)
            )
            conflict = f"the identifier {message.frame_id:#x} belongs to {' and to '.join(places)}"
            if other.bus_name != message.bus_name:
                raise DefinitionError(f"{path}: {conflict}; name one of them: {path}{_BUS_MARK}{message.bus_name}")
            _LOG.warning("%s: %s", path, conflict)
    for name, count in Counter(message.name for message in wanted).items():
        if count > 1:
            _LOG.warning("%s: %d messages are called %s", path, count, name)
    if len(wanted) == len(database.messages):
        return database
    return Database(
        messages=wanted, nodes=database.nodes, buses=database.buses, version=database.version,
        dbc_specifics=database.dbc, strict=False,
    )  # fmt: skip


def database_of(database: Database | Path | str) -> Database:
    """Return a database, loaded if it is a file's name; raises as ``load_database``."""
    return database if isinstance(database, Database) else load_database(Path(database))
