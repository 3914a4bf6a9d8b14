"""What in a DBC file cannot be right, line by line, and the text without it.

What is left out takes along what rests on it: a message its signals, a signal its texts. Nothing is left out that
would let another signal be read wrongly.

A statement that is wrong does not take the others along: it ends before the next semicolon, or before the next line
that begins with a keyword. The grammar is that of cantools, so what is sound here can be parsed there.
"""

import re
import unicodedata
from array import array
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from itertools import chain
from typing import Final

LONGEST_ITEM: Final = 60  # characters of a statement that are shown
NOBODY: Final = "Vector__XXX"  # how DBC files say that no node is meant

# A letter for each kind of token, so that statements can be told by regular expressions over tokens.
KEYWORDS: Final[Mapping[str, str]] = {
    "VERSION": "V", "NS_": "N", "BS_": "B", "BU_": "U", "BO_": "O", "SG_": "G", "CM_": "C", "BA_DEF_": "D",
    "BA_DEF_DEF_": "E", "BA_": "A", "BA_REL_": "R", "BA_DEF_REL_": "Q", "BA_DEF_DEF_REL_": "P", "BU_SG_REL_": "X",
    "BU_BO_REL_": "Y", "BU_EV_REL_": "Z", "VAL_": "L", "VAL_TABLE_": "T", "SIG_VALTYPE_": "F", "SG_MUL_VAL_": "M",
    "BO_TX_BU_": "K", "SIG_GROUP_": "H", "EV_": "J", "ENVVAR_DATA_": "I",
    **dict.fromkeys(("BA_DEF_SGTYPE_", "BA_SGTYPE_", "CAT_", "CAT_DEF_", "EV_DATA_", "FILTER", "NS_DESC_", "SGTYPE_",
                     "SGTYPE_VAL_", "SIG_TYPE_REF_", "SIGTYPE_VALTYPE_"), "k"),
}  # fmt: skip
FORMS: Final[Mapping[str, tuple[str, str]]] = {
    "V": (r"Vs", 'VERSION "text"'),
    "N": (r"N:[^:]*(?=[^:]:)", "NS_ : names"),
    "B": (r"B:", "BS_:"),
    "U": (r"U:w*", "BU_: nodes"),
    "O": (r"O[n]w:nw", "BO_ identifier name: length sender"),
    "G": (r"Gww?:n\|n@n\+\(n,n\)\[n\|n\]sw(?:,w)*",
          'SG_ name : start|length@order sign (scale,offset) [minimum|maximum] "unit" receivers'),
    "C": (r"C(?:Gnws|O[n]s|Jws|Uws|s);", 'CM_ what "text";'),
    "D": (r"D[GOJU]?sw(?:s(?:,s)*|n*);", 'BA_DEF_ what "name" type values;'),
    "E": (r"Es[ns];", 'BA_DEF_DEF_ "name" value;'),
    "A": (r"As(?:On|Gnw|Uw|Jw)*[ns];", 'BA_ "name" what value;'),
    "Q": (r"Q[XYZ]?sw(?:s(?:,s)*|n+)?;", 'BA_DEF_REL_ what "name" type values;'),
    "P": (r"Ps[ns];", 'BA_DEF_DEF_REL_ "name" value;'),
    "R": (r"R(?:sXwGnw|sYwn)[ns];", 'BA_REL_ "name" what value;'),
    "L": (r"Ln?w(?:ns)*;", 'VAL_ identifier signal number "text" ...;'),
    "T": (r"Tw(?:ns)*;", 'VAL_TABLE_ name number "text" ...;'),
    "F": (r"Fnw:n;", "SIG_VALTYPE_ identifier signal : type;"),
    "M": (r"Mnwwnn(?:,nn)*;", "SG_MUL_VAL_ identifier signal multiplexer first-last, ...;"),
    "K": (r"Kn:w(?:,w)*;", "BO_TX_BU_ identifier : nodes;"),
    "H": (r"Hnwn:w*;", "SIG_GROUP_ identifier name number : signals;"),
    "J": (r"Jw:n\[n\|n\]snnww(?:,w)*;", "EV_ name: ...;"),
    "I": (r"Iw:n;", "ENVVAR_DATA_ name: number;"),
}  # fmt: skip
_PATTERNS: Final = {kind: re.compile(pattern) for kind, (pattern, _) in FORMS.items()}
# A string in which a line begins like a statement lacks its closing quote.
_TOKEN: Final = re.compile(
    r"""[ \t\r\n]+|//[^\n]*|(?P<n>[-+]?[0-9]+\.?[0-9]*(?:[eE][-+]?[0-9]+)?)|(?P<w>(?:\w|[^\x00-\x7f\s])+)"""
    r"""|(?P<s>"(?:\\"|\\(?!")|[^"\n\\]|\n"""
    r"""(?![ \t]*(?:BO|SG|CM|BA|BA_DEF|BA_DEF_DEF|VAL|VAL_TABLE|SIG_VALTYPE)_\s))*?")"""
    r"""|(?P<p>.)""",
    re.DOTALL,
)
_STARTERS: Final = frozenset(FORMS) | {"k"}
# What mends a statement that is whole but for its last token.
_ENDINGS: Final = {"G": ("w", f" {NOBODY}", "names no receiver"), "O": ("w", f" {NOBODY}", "names no sender")}
_SEMICOLON: Final = (";", ";", "lacks its semicolon")


@dataclass(frozen=True, slots=True, kw_only=True)
class Statement:
    """One statement, or what stands where one should be."""

    kind: str  # the letter of its keyword
    tokens: range
    problem: str = ""  # why it is none; empty if it is sound
    ending: str = ""  # what would make it one


class Tokens:
    def __init__(self, text: str) -> None:
        self.text = text
        self.starts, self.stops = array("Q"), array("Q")
        self._lines = array("Q", (found.end() for found in re.finditer("\n", text)))
        kinds = []
        for found in _TOKEN.finditer(text):
            if found.lastgroup is not None:
                kinds.append(_kind(found.lastgroup, found.group()))
                self.starts.append(found.start())
                self.stops.append(found.end())
        self.kinds = "".join(kinds)

    def word(self, index: int) -> str:
        """Return a token as it stands; a string without its quotes."""
        word = self.text[self.starts[index] : self.stops[index]]
        return word[1:-1].replace('\\"', '"') if self.kinds[index] == "s" else word

    def words(self, statement: Statement) -> list[str]:
        return [self.word(index) for index in statement.tokens]

    def span(self, statement: Statement) -> tuple[int, int]:
        """Return where a statement begins and ends in the text."""
        return self.starts[statement.tokens[0]], self.stops[statement.tokens[-1]]

    def line(self, position: int) -> int:
        return bisect_right(self._lines, position) + 1

    def item(self, statement: Statement) -> str:
        """Return the beginning of a statement, on one line."""
        start, stop = self.span(statement)
        text = " ".join(self.text[start : min(stop, start + 4 * LONGEST_ITEM)].split())
        return text if len(text) <= LONGEST_ITEM else f"{text[: LONGEST_ITEM - 3]}..."

    def statements(self) -> Iterator[Statement]:
        """Yield all statements, sound or not."""
        index = 0
        while index < len(self.kinds):
            kind = self.kinds[index]
            found = _PATTERNS[kind].match(self.kinds, index) if kind in _PATTERNS else None
            statement = (
                self._broken(kind, index) if found is None else Statement(kind=kind, tokens=range(index, found.end()))
            )
            yield statement
            index = statement.tokens.stop

    def _broken(self, kind: str, index: int) -> Statement:
        stop = index + 1
        while stop < len(self.kinds) and self.kinds[stop - 1] != ";" and not self._begins_statement(stop):
            stop += 1
        tokens = range(index, stop)
        for code, ending, problem in (_SEMICOLON, _ENDINGS.get(kind, _SEMICOLON)):
            if kind in _PATTERNS and _PATTERNS[kind].fullmatch(self.kinds[index:stop] + code):
                return Statement(kind=kind, tokens=tokens, problem=problem, ending=ending)
        return Statement(kind=kind, tokens=tokens, problem=self._problem(kind, tokens))

    def _begins_statement(self, index: int) -> bool:
        """Return whether a keyword is the first word of its line."""
        if self.kinds[index] not in _STARTERS:
            return False
        start = self.starts[index]
        return not self.text[self.text.rfind("\n", 0, start) + 1 : start].strip()

    def _problem(self, kind: str, tokens: range) -> str:
        for index in tokens:
            if self.kinds[index] == "?":
                return f"the character {self.word(index)!r} belongs to no statement"
        if kind in FORMS:
            return f"is not of the form {FORMS[kind][1]}"
        return "is a statement that is not understood" if kind == "k" else "belongs to no statement"


def _kind(group: str, text: str) -> str:
    if group == "w":
        return KEYWORDS.get(text, "w")
    if group == "p":
        return text if text in "()[],|@;:" else "+" if text in "+-" else "?"
    return group


EXTENDED_BIT: Final = 1 << 31
STANDARD_BITS, EXTENDED_BITS = 11, 29
INDEPENDENT: Final = "VECTOR__INDEPENDENT_SIG_MSG"  # where CANdb++ keeps signals of no message
FLOAT_TYPES: Final = frozenset({1, 2})
FLOAT_BITS: Final = frozenset({16, 32, 64})
_WHOLE: Final = re.compile(r"[-+]?[0-9]+")
_MARKER: Final = re.compile(r"M|m[0-9]+M?")
_SPELLED: Final = {"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue", "ß": "ss"}
NOT_WHOLE: Final = "the identifier must be a whole number"
LEAST_TEXT_WORDS: Final = 4  # of VAL_ without a single text
WHOLE_KINDS: Final = frozenset({"INT", "HEX", "ENUM"})
NUMBER_KINDS: Final = frozenset({"INT", "HEX", "FLOAT"})
FRAME_FORMATS: Final = 16  # that CAN FD and J1939 databases tell apart
TEXT: Final = "STRING"
# Attributes that mean something, and of which kinds they may be.
KINDS: Final[Mapping[str, frozenset[str]]] = {
    "SPN": WHOLE_KINDS,
    "GenSigStartValue": WHOLE_KINDS | {"FLOAT"},
    "DBName": frozenset({TEXT}),
    "VFrameFormat": frozenset({"INT", "ENUM"}),
    "Baudrate": WHOLE_KINDS | {"FLOAT"},
}
OWNERS: Final = frozenset({"SG_", "BO_", "EV_", "BU_", "BU_SG_REL_", "BU_BO_REL_", "BU_EV_REL_"})
CHOSEN: Final = frozenset({"GenMsgSendType", "VFrameFormat"})  # whose value is the place of a choice


@dataclass(frozen=True, slots=True, kw_only=True)
class _Definition:
    kind: str
    choices: int


@dataclass(slots=True)
class AttributeRules:
    """What a file defines, and whether values keep to it."""

    _defined: dict[str, _Definition] = field(default_factory=dict)
    _related: dict[str, _Definition] = field(default_factory=dict)

    def define(self, words: list[str]) -> str:
        """Take up a definition; return what is wrong with it, empty if nothing is."""
        at = 2 if words[1] in OWNERS else 1
        name, kind = words[at : at + 2]
        values = [value for value in words[at + 2 : -1] if value != ","]
        if kind in NUMBER_KINDS and values:
            if len(values) < 2:
                return "its range has one end only"
            if cause := wrong_number(kind, values[0]) or wrong_number(kind, values[1]):
                return cause
        if kind not in KINDS.get(name, {kind}):
            return f"the attribute {name} cannot be of the kind {kind}"
        table = self._related if words[0] == "BA_DEF_REL_" else self._defined
        table[name] = _Definition(kind=kind, choices=len(values) if kind == "ENUM" else 0)
        return ""

    def check_default(self, words: list[str]) -> str:
        """Return what is wrong with a default value; empty if nothing is."""
        definition = (self._related if words[0] == "BA_DEF_DEF_REL_" else self._defined).get(words[1])
        if definition is None or definition.kind not in NUMBER_KINDS:
            return ""
        return wrong_number(definition.kind, words[2])

    def check_value(self, words: list[str]) -> str:
        """Return what is wrong with the value of an attribute; empty if nothing is."""
        definition = (self._related if words[0] == "BA_REL_" else self._defined).get(words[1])
        if definition is None:
            return f"the attribute {words[1]} is not defined"
        owners = [words[at + 1] for at, word in enumerate(words) if word in {"BO_", "SG_"}]
        if not all(owner.isascii() and owner.isdecimal() for owner in owners):
            return NOT_WHOLE
        name, value = words[1], words[-2]
        if definition.kind in WHOLE_KINDS | {"FLOAT"} and (cause := wrong_number(definition.kind, value)):
            return cause
        choices = FRAME_FORMATS if name == "VFrameFormat" and definition.kind == "INT" else definition.choices
        if name in CHOSEN and choices and not 0 <= int(Decimal(value)) < choices:
            return f"its value is not one of the {choices} choices"
        return ""


def wrong_number(kind: str, value: str) -> str:
    """Return why a text is no number of some kind; empty if it is one."""
    try:
        number = Decimal(value)
    except InvalidOperation:
        return f"{value[:20]!r} is not a number, as the kind {kind} asks for"
    return "" if number.is_finite() and abs(number) < Decimal(10) ** 30 else "its value is not a usable number"


@dataclass(frozen=True, slots=True, kw_only=True)
class Offence:
    """One item that cannot be right."""

    line: int
    item: str  # its beginning
    cause: str
    is_mended: bool = False  # else it is left out
    is_harmless: bool = False  # nothing is lost without it

    def __str__(self) -> str:
        return f"line {self.line}: {self.item}: {self.cause}"


@dataclass(frozen=True, slots=True, kw_only=True)
class SievedSignal:
    """What other statements may say of a signal depends on."""

    statement: Statement
    marker: str
    length_bits: int


@dataclass(slots=True, kw_only=True)
class SievedMessage:
    """A message and its signals, by name."""

    name: str
    signals: dict[str, SievedSignal] = field(default_factory=dict)
    selected: set[str] = field(default_factory=set)  # signals whose multiplexer SG_MUL_VAL_ names

    @property
    def multiplexers(self) -> set[str]:
        """The names of the signals that select others."""
        return {name for name, signal in self.signals.items() if signal.marker.endswith("M")}


class Sieve:
    """Looks at one text; ``offences`` says what is wrong with it, ``text`` what is left."""

    def __init__(self, text: str) -> None:
        self._tokens = Tokens(text)
        self._edits: dict[range, tuple[int, int, str]] = {}  # by tokens: what stands there instead
        self._messages: dict[int, list[SievedMessage]] = {}  # by identifier; several, where one is there twice
        self._attributes = AttributeRules()
        self._names: dict[str, str] = {}
        self.offences: list[Offence] = []
        self.has_messages = False
        self._rename()
        statements = list(self._sound())
        self._read_messages(statements)
        self._check("DQ", statements, self._attributes.define)
        self._check("EP", statements, self._attributes.check_default)
        self._check("M", statements, self._check_multiplexer)
        self._check_markers()
        self._check("F", statements, self._check_type)
        self._check("L", statements, self._check_texts)
        self._check("AR", statements, self._attributes.check_value)
        self._check("KHCJ", statements, check_numbers)
        self.offences.sort(key=lambda offence: offence.line)

    @property
    def text(self) -> str:
        """The text without what is wrong with it; what remains keeps its line."""
        pieces, position = list[str](), 0
        if not self.offences:
            return self._tokens.text
        for start, stop, instead in sorted(self._edits.values(), key=lambda edit: (edit[0], -edit[1], edit[2])):
            if start < position:
                continue
            pieces += (self._tokens.text[position:start], instead, "\n" * self._tokens.text.count("\n", start, stop))
            position = stop
        return "".join([*pieces, self._tokens.text[position:]])

    def _rename(self) -> None:
        """Spell names in ASCII, the only letters that the grammar knows."""
        tokens = self._tokens
        if tokens.text.isascii():
            return
        known = {tokens.word(index) for index, kind in enumerate(tokens.kinds) if kind == "w"}
        for index, kind in enumerate(tokens.kinds):
            if kind != "w" or (name := tokens.word(index)).isascii():
                continue
            start, stop = tokens.starts[index], tokens.stops[index]
            if name not in self._names:
                self._names[name] = spelled = in_ascii(name, known)
                known.add(spelled)
                cause = f"a name has other letters than A to Z; it is called {spelled}"
                self.offences.append(Offence(line=tokens.line(start), item=name, cause=cause, is_mended=True))
            self._edits[range(index, index + 1)] = (start, stop, self._names[name])

    def _words(self, statement: Statement) -> list[str]:
        words = [self._names.get(word, word) for word in self._tokens.words(statement)]
        return [*words, statement.ending.strip()] if statement.ending else words

    def _sound(self) -> Iterator[Statement]:
        """Yield the statements that are sound, or can be mended."""
        for statement in self._tokens.statements():
            if not statement.problem:
                if statement.kind == "N":  # it would end elsewhere if what follows it is left out, and means nothing
                    self._edits[statement.tokens] = (*self._tokens.span(statement), "")
                yield statement
            elif statement.ending:
                _, stop = self._tokens.span(statement)
                self._edits[statement.tokens] = (stop, stop, statement.ending)
                self._offend(statement, f"{statement.problem}; it is read as if it had one", is_mended=True)
                yield statement
            else:
                self._leave_out(statement, statement.problem)

    def _offend(self, statement: Statement, cause: str, **traits: bool) -> None:
        line, item = self._tokens.line(self._tokens.span(statement)[0]), self._tokens.item(statement)
        self.offences.append(Offence(line=line, item=item, cause=cause, **traits))

    def _leave_out(self, statement: Statement, cause: str, *, is_harmless: bool = False) -> None:
        removal = (*self._tokens.span(statement), "")
        if self._edits.get(statement.tokens) != removal:
            self._edits[statement.tokens] = removal
            self._offend(statement, cause, is_harmless=is_harmless)

    def _read_messages(self, statements: list[Statement]) -> None:
        current: SievedMessage | None = None
        is_open = False  # signals may follow
        for statement in statements:
            if statement.kind == "O":
                current, cause = self._message(self._words(statement))
                is_open = True
                if cause:
                    self._leave_out(statement, cause)
            elif statement.kind != "G":
                is_open = False
            elif not is_open:
                self._leave_out(statement, "it belongs to no message")
            elif current is None:
                self._leave_out(statement, "its message is left out")
            elif cause := add_signal(self._words(statement), statement, current):
                self._leave_out(statement, cause)

    def _message(self, words: list[str]) -> tuple[SievedMessage | None, str]:
        """Return the message of a statement, or why it is none."""
        _, identifier, name, _, length, *_ = words
        self.has_messages = True
        if not (_is_whole(identifier) and _is_whole(length)) or (len(length) > 1 and length.startswith("0")):
            return None, "identifier and length must be whole numbers"
        number = int(identifier)
        bits = (number & ~EXTENDED_BIT).bit_length()
        most_bits = EXTENDED_BITS if number & EXTENDED_BIT else STANDARD_BITS
        message = SievedMessage(name=name)
        if name != INDEPENDENT and (number < 0 or bits > most_bits):
            return None, f"the identifier has more than {most_bits} bits"
        self._messages.setdefault(number, []).append(message)
        return message, ""

    def _check(self, kinds: str, statements: list[Statement], find_cause: Callable[[list[str]], str]) -> None:
        """Leave out the statements of some kinds that there is a cause to leave out."""
        for statement in statements:
            if statement.kind in kinds and (cause := find_cause(self._words(statement))):
                is_harmless = cause == INDEPENDENT
                self._leave_out(statement, "of no message" if is_harmless else cause, is_harmless=is_harmless)

    def _find(self, identifier: str, signal: str) -> SievedMessage | str:
        """Return the message of a signal, or why there is none."""
        if not _is_whole(identifier):
            return NOT_WHOLE
        messages = self._messages.get(int(identifier), [])
        if not messages:
            return f"there is no message {identifier}"
        if any(message.name == INDEPENDENT for message in messages):
            return INDEPENDENT
        lacking = f"message {messages[0].name} ({identifier}) has no signal {signal}"
        return next((message for message in messages if signal in message.signals), lacking)

    def _check_texts(self, words: list[str]) -> str:
        if not _is_whole(words[1]):
            return ""  # of an environment variable
        if not all(_is_whole(number) for number in words[3:-1:2]):
            return "its numbers must be whole"
        message = self._find(words[1], words[2])
        return message if isinstance(message, str) and len(words) > LEAST_TEXT_WORDS else ""

    def _check_type(self, words: list[str]) -> str:
        _, identifier, name, _, number, *_ = words
        message = self._find(identifier, name)
        if isinstance(message, str):
            return message
        signal = message.signals[name]
        is_float = _is_whole(number) and int(number) in FLOAT_TYPES
        if is_float and signal.length_bits not in FLOAT_BITS:
            self._forget(message, name, f"SIG_VALTYPE_ makes it a float of {signal.length_bits} bits")
            return "its signal is left out"
        return "" if is_float or number in {"0", "+0"} else f"there is no type {number}"

    def _check_multiplexer(self, words: list[str]) -> str:
        _, identifier, name, multiplexer, *ranges = words
        message = self._find(identifier, name)
        if isinstance(message, str):  # of nothing, it does no harm
            return message if message == NOT_WHOLE else ""
        if multiplexer not in message.multiplexers:
            return f"message {message.name} has no multiplexer {multiplexer}"
        for first, last in zip(ranges[0::3], ranges[1::3], strict=False):
            if not (_is_whole(first) and last.startswith("-") and _is_whole(last)):
                return "its ranges must be whole numbers"
        message.selected.add(name)
        return ""

    def _check_markers(self) -> None:
        """Leave out the signals of which nothing says when they are there."""
        for message in chain.from_iterable(self._messages.values()):
            multiplexers = message.multiplexers
            for name, signal in tuple(message.signals.items()):
                is_selected = signal.marker.startswith("m") and name not in message.selected
                if is_selected and not multiplexers and message.name != INDEPENDENT:
                    self._forget(message, name, f"it is multiplexed, but {message.name} has no multiplexer (M)")
                elif is_selected and len(multiplexers) > 1:
                    several = ", ".join(sorted(multiplexers))
                    self._forget(message, name, f"SG_MUL_VAL_ does not say which of {several} selects it")

    def _forget(self, message: SievedMessage, name: str, cause: str) -> None:
        self._leave_out(message.signals.pop(name).statement, cause)


def check_numbers(words: list[str]) -> str:
    """Return what is wrong with the numbers of a statement that bears on no value; empty if nothing is."""
    places: Mapping[str, tuple[int, ...]] = {"BO_TX_BU_": (1,), "SIG_GROUP_": (1, 3), "EV_": (3, 11)}
    at = (2,) if words[1] in {"SG_", "BO_"} else places.get(words[0], ())
    return "" if all(_is_whole(words[place]) for place in at) else NOT_WHOLE


def add_signal(words: list[str], statement: Statement, message: SievedMessage) -> str:
    """Add a signal to its message; return why it cannot be, if so."""
    colon = words.index(":")
    name, marker = words[1], "".join(words[2:colon])
    start, length = words[colon + 1], words[colon + 3]
    if not (_is_whole(start) and _is_whole(length)) or int(start) < 0 or int(length) <= 0:
        return "start and length must be whole numbers, the length above 0"
    if marker and not _MARKER.fullmatch(marker):
        hint = ", without its number" if marker == "m" else ""
        return f"{marker} is not a multiplexer's mark{hint} (M, or m and a number)"
    if name in message.signals and message.name != INDEPENDENT:
        return f"message {message.name} has another signal {name}"
    message.signals[name] = SievedSignal(statement=statement, marker=marker, length_bits=int(length))
    return ""


def in_ascii(name: str, taken: set[str]) -> str:
    """Return a name in the letters that DBC files may use, unlike any that is taken."""
    plain = "".join(_letter_in_ascii(letter) for letter in unicodedata.normalize("NFC", name))
    plain = plain if plain and not plain[0].isdigit() else f"_{plain}"
    while plain in taken:
        plain += "_"
    return plain


def _letter_in_ascii(letter: str) -> str:
    if letter in _SPELLED or letter.isascii():
        return _SPELLED.get(letter, letter)
    base = unicodedata.normalize("NFKD", letter)[0]
    return base if base.isascii() and base.isalnum() else f"u{ord(letter):04x}"


def _is_whole(text: str) -> bool:
    return _WHOLE.fullmatch(text) is not None and len(text) <= 20
