"""The text of a DBC file as statements, each by itself: one that is wrong does not take the others along.

The grammar is that of cantools, so what is sound here can be parsed there. A wrong statement ends before the next
semicolon, or before the next line that begins with a keyword.
"""

import re
from array import array
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
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
    """The tokens of a text."""

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
