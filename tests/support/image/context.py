"""The build context: which files .dockerignore leaves, by the rules of moby/patternmatcher."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Self

# Made by tools, never part of a fresh clone.
NOT_CLONED = frozenset(
    {".git", ".venv", ".venv-silkit", ".mypy_cache", ".ruff_cache", ".pytest_cache", ".hypothesis", "__pycache__"}
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pattern:
    """One line of .dockerignore."""

    regex: "re.Pattern[str]"
    is_exception: bool

    @classmethod
    def parse(cls, text: str) -> Self:
        is_exception = text.startswith("!")
        return cls(regex=re.compile(_regex(_cleaned(text.removeprefix("!").strip()))), is_exception=is_exception)

    def matches(self, path: PurePosixPath) -> bool:
        """Return whether it matches the path or a folder above it."""
        return any(self.regex.fullmatch(str(part)) for part in (path, *path.parents))


def read_patterns(text: str) -> list[Pattern]:
    """Return the patterns of a .dockerignore; comments begin in the first column."""
    lines = [line.strip() for line in text.splitlines() if not line.startswith("#")]
    return [Pattern.parse(line) for line in lines if line and line != "!"]


def is_ignored(path: str, patterns: list[Pattern]) -> bool:
    """Return whether a file is left out: the last pattern that matches decides."""
    matching = [pattern for pattern in patterns if pattern.matches(PurePosixPath(path))]
    return bool(matching) and not matching[-1].is_exception


def context_files(root: Path) -> Iterator[str]:
    """Yield the files of a clone that .dockerignore leaves to the build, relative to its root."""
    patterns = read_patterns((root / ".dockerignore").read_text(encoding="utf-8"))
    cloned = (top for top in root.iterdir() if top.name not in NOT_CLONED)
    for path in sorted(path for top in cloned for path in (top, *top.rglob("*"))):
        relative = path.relative_to(root)
        if NOT_CLONED.isdisjoint(relative.parts) and path.is_file() and not is_ignored(relative.as_posix(), patterns):
            yield relative.as_posix()


def _cleaned(text: str) -> str:
    """Clean a path as Go's filepath.Clean does; a leading slash means nothing."""
    parts: list[str] = []
    for part in text.split("/"):
        if part == ".." and parts:
            parts.pop()
        elif part not in {"", ".", ".."}:
            parts.append(part)
    return "/".join(parts)


def _regex(pattern: str) -> str:
    regex, at = "", 0
    while at < len(pattern):
        rest = pattern[at:]
        if rest.startswith("**/"):
            regex, at = regex + "(?:.*/)?", at + 3
        elif rest.startswith("**"):
            regex, at = regex + ".*", at + 2
        elif rest[0] == "*":
            regex, at = regex + "[^/]*", at + 1
        elif rest[0] == "?":
            regex, at = regex + "[^/]", at + 1
        elif rest[0] == "\\" and len(rest) > 1:
            regex, at = regex + re.escape(rest[1]), at + 2
        elif (found := re.match(r"\[\^?[^\]]+\]", rest)) is not None:
            regex, at = regex + found[0], at + len(found[0])
        else:
            regex, at = regex + re.escape(rest[0]), at + 1
    return regex
