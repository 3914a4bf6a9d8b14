"""A DBC text as statements: one that cannot be read is left out with its line, and all others are read.

Each stage is a function from a text to edits of it. An edit keeps the lines, so that a cause has that of the file.
"""

import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from itertools import pairwise, takewhile
from typing import Final

STANDARD_IDS: Final = 1 << 11
EXTENDED_IDS: Final = 1 << 29
EXTENDED: Final = 1 << 31
_TEXT: Final = re.compile(r'//[^\n]*|"(?:\\"|[^"\\]|\\(?!"))*+(?:"|\Z)')  # as cantools reads texts and comments
_START: Final = re.compile(
    r"^[ \t]*+(?P<keyword>VERSION|NS_|BS_|BU_|BO_|SG_|CM_|BA_(?:DEF_){0,2}(?:REL_)?|VAL_(?:TABLE_)?|SIG_GROUP_"
    r"|SIG_VALTYPE_|SG_MUL_VAL_|BO_TX_BU_|EV_|ENVVAR_DATA_)(?=[ \t]*+:|[ \t]++\S)",  # NS_ lists keywords alone
    re.MULTILINE,
)
_MESSAGE: Final = re.compile(r"\s*BO_\s+(?P<number>[^\s:]+)\s+(?P<name>\w+)\s*:\s*(?P<length>\S+)")
_SIGNAL: Final = re.compile(
    r"\s*SG_\s+(?P<name>\w+)(?:\s+(?P<mark>[\w-]+))?\s*:"
    r"\s*(?P<start>\S+?)\s*\|\s*(?P<length>\S+?)\s*@\s*(?P<order>\d+)\s*[+-]"
)
_HEAD: Final = re.compile(r"\s*SG_\s+(?P<name>\w+)(?:\s+(?P<mark>[\w-]+))?\s*:")
_OF_SIGNAL: Final = re.compile(
    r"\s*(?P<statement>(?:VAL_|SIG_VALTYPE_|SG_MUL_VAL_)\s+(?P<number>\d+)\s+(?P<signal>\w+))"
)
_REFERENCE: Final = re.compile(
    r"\b((?:BO_|SG_|VAL_|SIG_VALTYPE_|SG_MUL_VAL_|SIG_GROUP_|BO_TX_BU_|BU_BO_REL_\s+\w+)\s+)(\d+)\b"
)
_ATTRIBUTE: Final = re.compile(r'\s*(?:BA_|BA_REL_)\s+"(?P<name>[^"]*)"')
_DEFINITION: Final = re.compile(r'\s*BA_DEF_(?:REL_)?\s+(?:\w+_\s+)?"(?P<name>[^"]*)"\s+(?P<type>\w+)')
_LAST_VALUE: Final = re.compile(r'(?P<value>"[^"]*"|\S+)\s*;\s*\Z')
_PAGE: Final = re.compile(r"m\d+M?")
_ANY_MESSAGE: Final = "BO_ 0 M : 8 A\n"
_ANY_END: Final = "\nBS_:\n"  # NS_ reaches up to it
_CURSOR: Final = ">>!<<"  # the parser's mark of where an error is
_UNASSIGNED: Final = "VECTOR__INDEPENDENT_SIG_MSG"  # holds the signals of no message


@dataclass(frozen=True, slots=True, kw_only=True)
class Edit:
    """A stretch of a text to replace, and what to tell of it; empty if it goes with another that is told."""

    start: int
    stop: int
    cause: str
    replacement: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Statement:
    """A statement with all up to the next; ``plain`` is as long and has blanks for texts and comments."""

    keyword: str
    start: int
    text: str
    plain: str

    @property
    def stop(self) -> int:
        return self.start + len(self.text)

    def left_out(self, cause: str = "") -> Edit:
        return Edit(start=self.start, stop=self.stop, cause=cause)


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """A message's statement and those of the signals behind it."""

    head: Statement
    signals: tuple[Statement, ...]

    @property
    def number(self) -> int | None:
        """Return the identifier with the mark of 29 bits, None if it is no number."""
        match = _MESSAGE.match(self.head.plain)
        return int(match["number"]) if match and match["number"].isdecimal() else None

    def left_out(self, cause: str) -> list[Edit]:
        return [
            self.head.left_out(cause + _with_signals(self.signals)),
            *(signal.left_out() for signal in self.signals),
        ]


def _with_signals(signals: Sequence[Statement]) -> str:
    if not signals:
        return ""
    return f", with the {len(signals)} signals behind it" if len(signals) > 1 else ", with the signal behind it"


def plain_of(text: str) -> str:
    """Return a text of the same length and lines, with blanks for what stands in quotes or comments."""

    def blank(match: re.Match[str]) -> str:
        inner = re.sub(r"[^\n]", " ", match[0])
        return inner if match[0].startswith("/") else f'"{inner[1:-1]}"' if len(inner) > 1 else '"'

    return _TEXT.sub(blank, text)


def line_number(text: str, position: int) -> int:
    return text.count("\n", 0, position) + 1


def statements_of(text: str) -> list[Statement]:
    """Return the statements in their order; what stands before the first is one without a keyword."""
    plain = plain_of(text)
    starts = [(match.start(), match["keyword"]) for match in _START.finditer(plain)]
    if plain[: starts[0][0] if starts else len(plain)].strip():
        starts.insert(0, (0, ""))
    return [
        Statement(keyword=keyword, start=start, text=text[start:stop], plain=plain[start:stop])
        for (start, keyword), (stop, _) in pairwise([*starts, (len(text), "")])
    ]


def groups_of(statements: Sequence[Statement]) -> list[Group]:
    """Return every message with the signals that stand behind it."""
    return [
        Group(head=head, signals=tuple(_signals_behind(statements, place)))
        for place, head in enumerate(statements)
        if head.keyword == "BO_"
    ]


def _signals_behind(statements: Sequence[Statement], place: int) -> Iterator[Statement]:
    return takewhile(
        lambda statement: statement.keyword == "SG_", (statements[k] for k in range(place + 1, len(statements)))
    )


def message_count(text: str) -> int:
    """Return how many lines name a message, whether they can be read or not."""
    return sum(match["keyword"] == "BO_" for match in _START.finditer(text))


def left_out_at(text: str, causes: Iterable[tuple[int, str]]) -> list[Edit]:
    """Return the edits that leave out the statements at some places, messages with their signals."""
    statements = statements_of(text)
    starts = [statement.start for statement in statements]
    groups = {group.head.start: group for group in groups_of(statements)}
    edits = list[Edit]()
    for place, cause in causes:
        statement = statements[bisect_right(starts, place) - 1]
        group = groups.get(statement.start)
        edits += group.left_out(cause) if group else [statement.left_out(cause)]
    return edits


def edited(text: str, edits: Iterable[Edit]) -> tuple[str, list[tuple[int, str]]]:
    """Return the text with its edits, line and cause of each that is told; of two that overlap the first is made."""
    pieces, causes, stop = list[str](), list[tuple[int, str]](), 0
    for edit in sorted(edits, key=lambda edit: (edit.start, not edit.cause)):
        if edit.start < stop:
            continue
        replacement = edit.replacement or re.sub(r"[^\n]", " ", text[edit.start : edit.stop])
        pieces += text[stop : edit.start], replacement
        stop = edit.stop
        if edit.cause:
            cause = edit.cause if edit.replacement else f"{edit.cause} (left out)"
            causes.append((line_number(text, edit.start), cause))
    return "".join((*pieces, text[stop:])), causes


def outside_grammar(text: str, syntax_error: Callable[[str], str]) -> list[Edit]:
    """Return what to leave out of a text that the parser does not take; ``syntax_error`` is empty for what it takes.

    Signals behind a line that cannot be read might be of its message: only behind a signal of one line they are kept.
    """
    statements = statements_of(text)
    orphans = [
        statement.left_out("a signal stands behind no message")
        for before, statement in pairwise([Statement(keyword="", start=0, text="", plain=""), *statements])
        if statement.keyword == "SG_" and before.keyword not in {"BO_", "SG_"}
    ]
    if orphans:
        return orphans
    places = {statement.start: place for place, statement in enumerate(statements)}
    inner_starts = sorted({match.start() for match in _START.finditer(text)} - places.keys())
    edits = list[Edit]()
    for statement, error in _refused(statements, syntax_error):
        inner = bisect_right(inner_starts, statement.start)
        if inner < len(inner_starts) and inner_starts[inner] < statement.stop:  # a quote that nothing closes
            edits.append(Edit(start=statement.start, stop=inner_starts[inner], cause=error))
            return edits
        edits += _without_grammar(statement, error, _signals_behind(statements, places[statement.start]), syntax_error)
    return edits


def _without_grammar(
    statement: Statement, error: str, behind: Iterable[Statement], syntax_error: Callable[[str], str]
) -> list[Edit]:
    """Return what to leave out of a statement outside the grammar, and of the signals behind it."""
    line_stop = statement.plain.find("\n", len(statement.plain) - len(statement.plain.lstrip())) + 1
    rest = statement.plain[line_stop:] if statement.keyword in {"BO_", "SG_"} and line_stop else ""
    left_out = statement.left_out(error)
    if rest.strip() and not syntax_error(_in_context(statement.keyword, statement.text[:line_stop])):
        start = statement.stop - len(rest.lstrip())
        left_out = Edit(start=start, stop=statement.stop, cause="not a statement of a DBC file")
    signals = [] if statement.keyword == "SG_" and not rest.strip() else list(behind)
    return [
        replace(left_out, cause=left_out.cause + _with_signals(signals)),
        *(signal.left_out() for signal in signals),
    ]


def _refused(statements: Sequence[Statement], syntax_error: Callable[[str], str]) -> Iterator[tuple[Statement, str]]:
    """Yield what the parser does not take by itself, found by halves."""
    if not statements or not (
        error := syntax_error(_in_context(statements[0].keyword, "".join(s.text for s in statements)))
    ):
        return
    if len(statements) == 1:
        yield statements[0], "the statement breaks off" if error.endswith(f'"{_CURSOR}{_ANY_END.strip()}"') else error
        return
    middle = len(statements) // 2
    yield from _refused(statements[:middle], syntax_error)
    yield from _refused(statements[middle:], syntax_error)


def _in_context(keyword: str, text: str) -> str:
    return f"{_ANY_MESSAGE if keyword == 'SG_' else ''}{text}{_ANY_END}"


def without_meaning(text: str) -> list[Edit]:
    """Return what to leave out or mend of a text within the grammar, before the parser gives it a meaning."""
    statements = statements_of(text)
    groups = groups_of(statements)
    unmarked = {group.number for group in groups if STANDARD_IDS <= (group.number or 0) < EXTENDED_IDS}
    edits = list[Edit]()
    for group in groups:
        edits += _of_message(group)
    edits += _marked(statements, frozenset(number for number in unmarked if number is not None))
    edits += _of_nothing(statements, groups)
    edits += _attributes(statements)
    return edits


def _of_message(group: Group) -> list[Edit]:
    """Return what is wrong with a message or with the form of its signals."""
    match, number = _MESSAGE.match(group.head.plain), group.number
    if match is None or match["name"] == _UNASSIGNED:
        return []
    if number is None or number >= 2 * EXTENDED or number % EXTENDED >= EXTENDED_IDS:
        return group.left_out(f"message {match['name']}: no CAN identifier is {match['number']}")
    if not match["length"].isdecimal():
        return group.left_out(f"message {match['name']}: its length is {match['length']}, not a number of bytes")
    return [*_forms(group), *_marks(group)]


def _forms(group: Group) -> Iterator[Edit]:
    for statement in group.signals:
        if signal := _SIGNAL.match(statement.plain):
            if not (signal["start"].isdecimal() and signal["length"].isdecimal() and int(signal["length"]) > 0):
                yield statement.left_out(f"signal {signal['name']}: {signal['start']}|{signal['length']} is no place")
            elif signal["order"] not in {"0", "1"}:
                yield statement.left_out(f"signal {signal['name']}: there is no byte order {signal['order']}")


def _marks(group: Group) -> Iterator[Edit]:
    """Yield the signals whose mark of a multiplexer has no meaning; a bare m is M where only that makes sense."""
    heads = [(statement, head) for statement in group.signals if (head := _HEAD.match(statement.plain))]
    marks = [head["mark"] for _, head in heads if head["mark"]]
    is_needed = any(_PAGE.fullmatch(mark) for mark in marks) and not any(mark.endswith("M") for mark in marks)
    is_multiplexer = is_needed and marks.count("m") == 1
    for statement, head in heads:
        mark = head["mark"] or "M"
        if mark == "m" and is_multiplexer:
            yield Edit(
                start=statement.start + head.start("mark"),
                stop=statement.start + head.end("mark"),
                cause=f"signal {head['name']}: its mark m is read as M, since others of its message have pages and "
                "nothing else selects them",
                replacement="M",
            )
        elif mark != "M" and not _PAGE.fullmatch(mark):
            cause = f"signal {head['name']}: {mark} is not a multiplexer's mark (M, or m and a number)"
            yield statement.left_out(cause)


def _marked(statements: Iterable[Statement], unmarked: frozenset[int]) -> Iterator[Edit]:
    """Yield the mark of 29 bits for every identifier that lacks it: no identifier of 11 bits is so large."""
    for statement in statements:
        for match in _REFERENCE.finditer(statement.plain) if unmarked else ():
            number, message = int(match[2]), _MESSAGE.match(statement.plain)
            if number in unmarked:
                name = message["name"] if message else ""
                cause = f"message {name}: identifier {number} lacks the mark of 29 bits, and is read as one of them"
                yield Edit(
                    start=statement.start + match.start(2),
                    stop=statement.start + match.end(2),
                    cause=cause if message else "",
                    replacement=str(number | EXTENDED),
                )


def _of_nothing(statements: Iterable[Statement], groups: Iterable[Group]) -> Iterator[Edit]:
    """Yield texts and types of values whose signal is not there."""
    signals = set[tuple[str, str]]()
    for group in groups:
        message = _MESSAGE.match(group.head.plain)
        heads = [_HEAD.match(statement.plain) for statement in group.signals]
        if message and message["name"] != _UNASSIGNED:
            signals |= {(message["number"], head["name"]) for head in heads if head}
    for statement in statements:
        of_signal = _OF_SIGNAL.match(statement.plain)
        if of_signal and (of_signal["number"], of_signal["signal"]) not in signals:
            yield statement.left_out(f"{' '.join(of_signal['statement'].split())} names no signal")


def _attributes(statements: Sequence[Statement]) -> Iterator[Edit]:
    """Yield attributes that nothing defines, and values that are not of the type."""
    definitions = [
        _DEFINITION.match(statement.text) for statement in statements if statement.keyword.startswith("BA_DEF_")
    ]
    types = {definition["name"]: definition["type"] for definition in definitions if definition}
    for statement in statements:
        attribute = _ATTRIBUTE.match(statement.text) if statement.keyword in {"BA_", "BA_REL_"} else None
        if attribute is None:
            continue
        if attribute["name"] not in types:
            yield statement.left_out(f"attribute {attribute['name']!r} is not defined")
            continue
        value = _LAST_VALUE.search(statement.text)
        if value and types[attribute["name"]] in {"INT", "HEX", "FLOAT", "ENUM"} and not _is_number(value["value"]):
            yield statement.left_out(f"attribute {attribute['name']!r}: {value['value']} is no number")


def _is_number(text: str) -> bool:
    try:
        return Decimal(text.strip('"')).is_finite()
    except InvalidOperation:
        return False


def signals_left_out(text: str, wrong: Iterable[tuple[int, str, str]]) -> list[Edit]:
    """Return the edits that leave out signals, by number of the message, name and cause; all of that name are meant."""
    causes = {(number, name): cause for number, name, cause in wrong}
    edits = list[Edit]()
    for group in groups_of(statements_of(text)):
        for statement in group.signals:
            head = _HEAD.match(statement.plain)
            if head and (cause := causes.get((group.number or 0, head["name"]))):
                edits.append(statement.left_out(cause))
    return edits


def with_pages(text: str, edits: Sequence[Edit]) -> list[Edit]:
    """Return the edits and those of all signals that a multiplexer selects which is left out."""
    left_out = {edit.start for edit in edits if not edit.replacement}
    pages = list[Edit]()
    for group in groups_of(statements_of(text)) if left_out else ():
        heads = [(statement, head) for statement in group.signals if (head := _HEAD.match(statement.plain))]
        lost = [
            head["name"]
            for statement, head in heads
            if statement.start in left_out and (head["mark"] or "").endswith("M")
        ]
        if group.head.start not in left_out and lost:
            pages += [
                statement.left_out(f"signal {head['name']}: its multiplexer {lost[0]} is left out")
                for statement, head in heads
                if _PAGE.fullmatch(head["mark"] or "")
            ]
    return [*edits, *pages]
