"""What a reader asks for: the words of an address become checked values, or one line that says which word is wrong."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import Enum
from typing import Final

from fleet_backend.errors import AskError
from fleet_backend.page.access import NOBODY, Viewer

MOST_IN_A_PART: Final = 1000
USUAL_IN_A_PART: Final = 50
# Control characters, those that only order, hide or tag others, those of private use: as signs, not as escapes, since
# the description of the interface says it in the same words to programs of other languages.
_NO_TEXT: Final = (
    "\x00-\x1f\x7f-\x9f\xad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ue000-\uf8ff\ufeff\ufff0-\ufffb"
    "\U000e0000-\U000e0fff\U000f0000-\U0010ffff"
)
TEXT: Final = f"[^{_NO_TEXT}]*"
_ENCODED_TEXT: Final = re.compile(
    f"[^{_NO_TEXT}\ud800-\udfff]*"
)  # without halves of characters, which JSON has none of
_NAME: Final = r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}"  # of vehicles, by the contract


class ParameterType(Enum):
    """What a word stands for; the value is the type in OpenAPI."""

    TEXT = "string"
    COUNT = "integer"
    MOMENT = "date-time"


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """A word of an address."""

    name: str
    text: str  # what it means
    kind: ParameterType = ParameterType.TEXT
    in_path: bool = False
    is_required: bool = False
    pattern: str | None = None
    longest: int = 200
    least: int = 1
    most: int = 2**63 - 1
    choices: tuple[str, ...] = ()
    default: int | None = None

    def read(self, word: str) -> str | int | datetime:
        """Return the value of a word; raises AskError."""
        if len(word) > self.longest:
            raise AskError(f"{self.name}: longer than {self.longest} characters")
        if not _ENCODED_TEXT.fullmatch(word):
            raise AskError(f"{self.name}: holds characters that are not text")
        if self.choices and word not in self.choices:
            raise AskError(f"{self.name}: must be one of {', '.join(self.choices)}")
        if self.pattern is not None and not re.fullmatch(self.pattern, word):
            raise AskError(f"{self.name}: is none")
        if self.kind is ParameterType.COUNT:
            return self._count(word)
        return _moment(self.name, word) if self.kind is ParameterType.MOMENT else word

    def _count(self, word: str) -> int:
        if not re.fullmatch(r"[0-9]{1,19}", word) or not self.least <= int(word) <= self.most:
            raise AskError(f"{self.name}: must be a whole number from {self.least} to {self.most}")
        return int(word)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ask:
    """A question, checked."""

    values: Mapping[str, str | int | datetime]
    now: datetime
    viewer: Viewer = NOBODY

    def text(self, name: str) -> str | None:
        """Return a text, or None where nothing was said."""
        value = self.values.get(name)
        return None if value is None else str(value)

    def said(self, name: str) -> str:
        """Return a text that is always said."""
        return str(self.values[name])

    def count(self, name: str) -> int:
        """Return a whole number that is said or has a default."""
        value = self.values[name]
        if not isinstance(value, int):
            raise TypeError(f"{name} is not a number")
        return value

    def moment(self, name: str, otherwise: datetime) -> datetime:
        value = self.values.get(name)
        return value if isinstance(value, datetime) else otherwise


VEHICLE: Final = Parameter(
    name="vehicle", text="name of the vehicle", in_path=True, is_required=True, pattern=_NAME, longest=64
)
AFTER: Final = Parameter(
    name="after", text="the part behind this one: `next` of the part before", pattern="[A-Za-z0-9_-]*", longest=400
)
LIMIT: Final = Parameter(
    name="limit", text="how many at most", kind=ParameterType.COUNT, most=MOST_IN_A_PART, default=USUAL_IN_A_PART
)


def read_words(
    parameters: Sequence[Parameter],
    path: Mapping[str, str],
    query: Iterable[tuple[str, str]],
    now: datetime,
    viewer: Viewer = NOBODY,
) -> Ask:
    """Return the question in an address; an empty word of a form was not said.

    Raises
    ------
    AskError
        Naming the first word that is unknown, said twice, missing or wrong.
    """
    words = dict(path)
    for name, word in query:
        if name in words:
            raise AskError(f"{name[:40]!r}: given twice")
        words[name] = word
    known = {one.name for one in parameters}
    for name in words:
        if name not in known:
            raise AskError(
                f"{name[:40]!r}: not a parameter of this address; it takes {', '.join(sorted(known)) or 'none'}"
            )
    values: dict[str, str | int | datetime] = {}
    for one in parameters:
        word = words.get(one.name, "")
        if word:
            values[one.name] = one.read(word)
        elif one.is_required:
            raise AskError(f"{one.name}: is missing")
        elif one.default is not None:
            values[one.name] = one.default
    return Ask(values=values, now=now, viewer=viewer)


def _moment(name: str, word: str) -> datetime:
    try:
        moment = datetime.fromisoformat(word)
        return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    except (ValueError, OverflowError) as exc:
        raise AskError(f"{name}: no date, such as 2026-01-31 or 2026-01-31T12:00Z") from exc
