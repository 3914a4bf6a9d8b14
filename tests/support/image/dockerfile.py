"""A Dockerfile as stages of instructions: the few words of it that are used here, and an error for any other."""

import json
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

KNOWN = frozenset({"FROM", "WORKDIR", "COPY", "RUN", "ENV", "USER", "CMD", "VOLUME", "ARG", "LABEL", "STOPSIGNAL"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Instruction:
    """One instruction; ``text`` is what follows its name, lines joined."""

    name: str
    text: str

    @property
    def words(self) -> list[str]:
        return shlex.split(self.text)

    @property
    def copy(self) -> "Copy":
        """What a COPY copies."""
        words, stage = self.words, None
        if words[0].startswith("--from="):
            stage = words.pop(0).removeprefix("--from=")
        if words[0].startswith("--"):
            raise ValueError(f"COPY {words[0]} is not understood by the tests")
        *sources, target = words
        return Copy(sources=tuple(sources), target=target, stage=stage)


@dataclass(frozen=True, slots=True, kw_only=True)
class Copy:
    """A COPY: from another stage or from the context."""

    sources: tuple[str, ...]
    target: str
    stage: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """What follows one FROM."""

    image: str
    name: str | None
    instructions: tuple[Instruction, ...]

    @property
    def copies(self) -> list[Copy]:
        return [entry.copy for entry in self.instructions if entry.name == "COPY"]

    @property
    def environment(self) -> dict[str, str]:
        pairs = [word.partition("=") for entry in self.instructions if entry.name == "ENV" for word in entry.words]
        return {name: value for name, _, value in pairs}

    @property
    def command(self) -> list[str]:
        words: list[str] = json.loads([entry.text for entry in self.instructions if entry.name == "CMD"][-1])
        return words


def read_stages(path: Path) -> list[Stage]:
    """Return the stages of a Dockerfile; comments may stand between the lines of an instruction."""
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.lstrip().startswith("#")]
    return list(_stages("\n".join(lines)))


def _stages(text: str) -> Iterator[Stage]:
    joined = re.sub(r"\\\n\s*", "", text)
    entries = [_instruction(line) for line in joined.splitlines() if line.strip()]
    starts = [index for index, entry in enumerate(entries) if entry.name == "FROM"]
    for start, end in zip(starts, [*starts[1:], len(entries)], strict=True):
        image, *rest = entries[start].words
        name = rest[1] if [word.upper() for word in rest[:1]] == ["AS"] else None
        yield Stage(image=image, name=name, instructions=tuple(entries[start + 1 : end]))


def _instruction(line: str) -> Instruction:
    name, _, text = line.strip().partition(" ")
    if name not in KNOWN:
        raise ValueError(f"{name} is not an instruction that the tests understand")
    return Instruction(name=name, text=text.strip())
