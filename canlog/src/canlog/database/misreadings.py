"""What cantools takes from a database though it cannot be right: found by name and line, so that nothing is misread."""

import re
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from cantools.database.can import Database, Message

from canlog.errors import DefinitionError

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
    return _STRING.sub(lambda found: '"' + "\n" * found[0].count("\n") + '"', text)


def line_of(text: str, position: int) -> str:
    return f"line {text.count(chr(10), 0, position) + 1}"


def check_sizes(text: str, database_format: str) -> None:
    """Raise DefinitionError for sizes that would make the parser fill the memory, before it sees them."""
    for found in _SIZES[database_format].finditer(text):
        size = {name: _number(digits) for name, digits in found.groupdict(default="0").items()}
        if max(8 * size.get("bytes", 0), size.get("start", 0) + size["bits"]) > MAX_BITS:
            raise DefinitionError(f"{line_of(text, found.start())}: {found[0][:60]}: no CAN message is so long")
    ranges = [_RANGE.findall(item["ranges"] or "") for item in _ITEM.finditer(text)] if database_format == "dbc" else []
    if sum(_number(last) - _number(first) for some in ranges for first, last in some) > MAX_MULTIPLEXED:
        raise DefinitionError("the ranges of SG_MUL_VAL_ are wider than those of any multiplexer")


def _number(digits: str) -> int:
    """Return a decimal number, or a billion if it has more digits than any size needs."""
    return int(digits) if len(digits) <= MAX_DIGITS else 10**MAX_DIGITS


def misreadings(text: str, database: Database) -> Iterator[str]:
    """Yield what cannot be right in a database that cantools took; ``text`` is the bare one of a DBC file, or empty."""
    signals: dict[int, dict[str, Signal]] = {}
    for message in database.messages:
        number = message.frame_id | (_EXTENDED if message.is_extended_frame else 0)
        signals.setdefault(number, {}).update((one.name, one) for one in message.signals)
        yield from _of_message(message)
    number = 0
    for found in _ITEM.finditer(text):
        number, mark, cause = int(found["message"] or number), found["mark"] or "M", ""
        signal = signals.get(int(found["paged"] or number), {}).get(found["signal"] or found["page"] or "")
        if not re.fullmatch(r"M|m\d+M?", mark):
            cause = f"signal {found['signal']}: {mark} is not a multiplexer's mark (M, or m and a number)"
        elif signal is not None and mark != "M" and not signal.multiplexer_ids:
            cause = f"signal {signal.name}: nothing says which multiplexer (M) of its message selects it"
        elif signal is not None and found["page"] and signal.multiplexer_signal != found["multiplexer"]:
            cause = f"SG_MUL_VAL_ of {signal.name}: its message has no multiplexer {found['multiplexer']}"
        elif found["type"] not in {None, "0", "1", "2"}:
            cause = f"SIG_VALTYPE_ {found['typed']}: there is no type {found['type']}"
        if cause:
            yield f"{line_of(text, found.start())}: {cause}"


def _of_message(message: Message) -> Iterator[str]:
    pages = Counter((signal.name, str(signal.multiplexer_ids)) for signal in message.signals)
    for name in (name for (name, _), count in pages.items() if count > 1):
        yield f"message {message.name} has another signal {name}"
    for signal in message.signals:
        if signal.is_float and signal.length not in FLOAT_BITS:
            yield f"signal {signal.name} of message {message.name} is a float of {signal.length} bits"
    for contained in message.contained_messages or ():
        yield from _of_message(contained)
