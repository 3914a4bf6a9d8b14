"""DBC files that name others to be read with them, as opendbc's templates do by ``CM_ "IMPORT common.dbc";``."""

import re
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from canlog.errors import DefinitionError

MAX_CHARACTERS: Final = 16 * 2**20  # of all files together, as of one
_IMPORT: Final = re.compile(r'^[ \t]*CM_[ \t]+"IMPORT[ \t]+(?P<name>[^"\n]+)"[ \t]*;', re.MULTILINE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Combined:
    """A text and those that it imports behind it."""

    text: str
    first_lines: tuple[int, ...]
    names: tuple[str, ...]  # empty for the file itself
    notices: tuple[str, ...]

    def place(self, line: int) -> str:
        """Return a line of the whole as one of its file."""
        part = bisect_right(self.first_lines, line) - 1
        own_line = f"line {line - self.first_lines[part] + 1}"
        return f"{self.names[part]}, {own_line}" if self.names[part] else own_line


def with_imports(file: Path, text: str, read_text: Callable[[Path], str]) -> Combined:
    """Return a text with all that it imports from its folder, each file once; raises DefinitionError if too long."""
    texts, names, notices = [text], [""], list[str]()
    for part, name in zip(texts, names, strict=False):  # both grow meanwhile
        for match in _IMPORT.finditer(part):
            wanted = match["name"].strip()
            place = f"{f'{name}, ' if name else ''}line {part.count(chr(10), 0, match.start()) + 1}"
            if wanted in {*names, file.name}:
                continue
            if Path(wanted).name != wanted or "\\" in wanted:
                notices.append(f"{place}: {wanted} is not imported: only files of the same folder are")
                continue
            try:
                texts.append(read_text(file.with_name(wanted)))
            except DefinitionError as error:
                notices.append(f"{place}: {wanted} is not imported: {error}")
                continue
            names.append(wanted)
            if sum(map(len, texts)) > MAX_CHARACTERS:
                raise DefinitionError(f"it and what it imports have more than {MAX_CHARACTERS} characters")
    first_lines = [1]
    for part in texts[:-1]:
        first_lines.append(first_lines[-1] + part.count("\n"))
    return Combined(text="".join(texts), first_lines=tuple(first_lines), names=tuple(names), notices=tuple(notices))
