"""Databases of other people, DBC, KCD, ARXML and SYM, by cantools; what it would misread is refused."""

import logging
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Final

import cantools
from cantools.database.can import Database, Message

from canlog.database.addressing import J1939, is_of_groups
from canlog.errors import NOTICE, DefinitionError
from canlog.files import is_there, read_small_file

if TYPE_CHECKING:
    from cantools.database.can.signal import Signal


MAX_BITS: Final = 8 * 1785  # longest J1939 transport message, far above any CAN frame
MAX_MULTIPLEXED: Final = 1_000_000  # values of multiplexers in a file, each of which the parser writes out
MAX_DIGITS: Final = 9  # no number that sizes something needs more
FLOAT_BITS: Final = frozenset({16, 32, 64})
_EXTENDED: Final = 1 << 31
_STRING: Final = re.compile(r'"(?:[^"\\]|\\.)*+(?:"|\Z)', re.DOTALL)
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
    r"|SIG_VALTYPE_\s++(?P<typed>\d++)\s++\w++\s*+:\s*+(?P<type>\d++))"
)


def bare(text: str) -> str:
    """Return a DBC text without its texts; what remains keeps its line."""
    return _STRING.sub(lambda match: '"' + "\n" * match[0].count("\n") + '"', text)


def line_of(text: str, position: int) -> str:
    return f"line {text.count(chr(10), 0, position) + 1}"


def check_sizes(text: str, database_format: str) -> None:
    """Raise DefinitionError for sizes that would make the parser fill the memory, before it sees them."""
    for match in _SIZES[database_format].finditer(text):
        size = {name: _number(digits) for name, digits in match.groupdict(default="0").items()}
        if max(8 * size.get("bytes", 0), size.get("start", 0) + size["bits"]) > MAX_BITS:
            raise DefinitionError(f"{line_of(text, match.start())}: {match[0][:60]}: no CAN message is so long")
    ranges = [_RANGE.findall(item["ranges"] or "") for item in _ITEM.finditer(text)] if database_format == "dbc" else []
    if sum(_number(last) - _number(first) for pairs in ranges for first, last in pairs) > MAX_MULTIPLEXED:
        raise DefinitionError("the ranges of SG_MUL_VAL_ are wider than those of any multiplexer")


def _number(digits: str) -> int:
    """Return a decimal number, or a billion if it has more digits than any size needs."""
    return int(digits) if len(digits) <= MAX_DIGITS else 10**MAX_DIGITS


def misreadings(text: str, database: Database) -> Iterator[str]:
    """Yield what cannot be right in a database that cantools took; ``text`` is the bare one of a DBC file, or empty."""
    signals: dict[int, dict[str, Signal]] = {}
    for message in database.messages:
        number = message.frame_id | (_EXTENDED if message.is_extended_frame else 0)
        signals.setdefault(number, {}).update((signal.name, signal) for signal in message.signals)
        yield from _of_message(message)
    number = 0
    for match in _ITEM.finditer(text):
        number, mark, cause = int(match["message"] or number), match["mark"] or "M", ""
        signal = signals.get(int(match["paged"] or number), {}).get(match["signal"] or match["page"] or "")
        if not re.fullmatch(r"M|m\d+M?", mark):
            cause = f"signal {match['signal']}: {mark} is not a multiplexer's mark (M, or m and a number)"
        elif signal is not None and mark != "M" and not signal.multiplexer_ids:
            cause = f"signal {signal.name}: nothing says which multiplexer (M) of its message selects it"
        elif signal is not None and match["page"] and signal.multiplexer_signal != match["multiplexer"]:
            cause = f"SG_MUL_VAL_ of {signal.name}: its message has no multiplexer {match['multiplexer']}"
        elif match["type"] not in {None, "0", "1", "2"}:
            cause = f"SIG_VALTYPE_ {match['typed']}: there is no type {match['type']}"
        if cause:
            yield f"{line_of(text, match.start())}: {cause}"


def _of_message(message: Message) -> Iterator[str]:
    pages = Counter((signal.name, str(signal.multiplexer_ids)) for signal in message.signals)
    for name in (name for (name, _), count in pages.items() if count > 1):
        yield f"message {message.name} has another signal {name}"
    for signal in message.signals:
        if signal.is_float and signal.length not in FLOAT_BITS:
            yield f"signal {signal.name} of message {message.name} is a float of {signal.length} bits"
    for contained in message.contained_messages or ():
        yield from _of_message(contained)


MAX_FILE_BYTES: Final = 16 * 2**20  # the largest public ones have 5 MB; parsing takes up to 70 times the memory
MAX_WARNINGS: Final = 20
HEAD_CHARACTERS: Final = 65_536  # from the first on, that tell the format

_LOG: Final = logging.getLogger(__name__)
_SYM: Final = re.compile(r"((?:\s|//[^\n]*\n)*)FormatVersion\s*=")  # comments may stand before it
_ROOT: Final = re.compile(r"<(?:[\w.-]+:)?([A-Za-z_][\w.-]*)[\s/>]")
_BUS_MARK: Final = "#"
_NARROW_BYTES: Final = 64  # looked at for UTF-16 without a byte-order mark
_BYTE_ORDER_MARKS: Final = (b"\xff\xfe", b"\xfe\xff")  # of UTF-16
_UNUSED: Final = re.compile(r"\b(VAL_|SIG_VALTYPE_) (\d+) (\w+)")  # as cantools names those of no signal
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


def load_database(path: Path | str, *, is_j1939: bool = False) -> Database:
    """Return the messages of a DBC, KCD, ARXML or SYM file; which one it is, its contents say.

    Signals that overlap or lie outside their message are warned of, message by message, and texts of values of no
    signal; whether the signals in use are sound is checked when they are mapped.

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
        If the file is missing, unreadable, of another format, has no messages, names sizes that no CAN message has, or
        has items that cannot be right.
    """
    file, bus = bus_of(Path(path))
    text = _read_text(file)
    database_format = _format_of(text, file)
    if database_format is DatabaseFormat.SYM and (begin := _SYM.match(text)):
        text = "\n" * begin[1].count("\n") + text[begin.end(1) :]  # cantools takes no such comments
    plain = bare(text) if database_format is DatabaseFormat.DBC else ""
    try:
        check_sizes(plain or text, database_format)
        database, unused = _parsed(text, database_format)
    except (cantools.Error, DefinitionError) as error:
        raise DefinitionError(f"{file} is not {database_format.in_words}: {_reason(error, text)}") from error
    if not database.messages:
        raise DefinitionError(f"{file} is not {database_format.in_words}, or it has no messages")
    wrong = list(misreadings(plain, database))
    if wrong:
        more = f"; {len(wrong) - 1} more like this" if len(wrong) > 1 else ""
        raise DefinitionError(f"{file} would be misread: {wrong[0]}{more}")
    _warn_each(file, [f"{statement} names no signal (left out)" for statement in unused])
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


def _parsed(text: str, database_format: str) -> tuple[Database, list[str]]:
    """Return what cantools makes of a text, and which texts of values had to be left out; raises cantools.Error."""
    unused = list[str]()
    while True:
        try:
            database = cantools.database.load_string(text, database_format=database_format, strict=False)
            break
        except cantools.Error as error:
            statements = _UNUSED.findall(str(error)) if "unused VAL_" in str(error) else []
            before = text
            for _, number, signal in statements:
                statement = rf'^[ \t]*VAL_\s+{number}\s+{signal}(?:\s+-?\d+\s+"(?:[^"\\]|\\.)*+")*\s*;'
                for match in re.finditer(statement, text, re.MULTILINE):
                    unused.append(f"{line_of(text, match.start())}: VAL_ {number} {signal}")
                    text = text[: match.start()] + re.sub(r"[^\n]", " ", match[0]) + text[match.end() :]
            if text == before:
                raise
    if not isinstance(database, Database):
        raise cantools.Error("it holds no CAN messages")
    return database, unused


def _reason(error: Exception, text: str) -> str:
    """Return what is wrong, with its line where that is known, in at most 160 characters."""
    cause = error.__cause__ or error
    reason, place = " ".join(str(cause).split()) or type(cause).__name__, ""
    if isinstance(cause, KeyError):
        reason, place = f"{reason} is not defined", f'"{re.escape(str(cause.args[0]))}"'
    elif unused := _UNUSED.search(reason):
        reason, place = f"{unused[0]} names no signal", r"\s+".join(unused.groups())
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
