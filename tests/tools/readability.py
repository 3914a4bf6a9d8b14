"""How readable the documents are: words, long sentences and reading ease of each page, before and after.

    python -m tests.tools.readability --rev v0.8.0

README, CONTRIBUTING, SECURITY and the pages of ``docs`` are counted, decisions are not. What a program writes is left
out: between ``<!-- name -->`` and ``<!-- end -->``, and the pages of ``make mismatch`` and ``make operating-curve``.
Words are those of the whole page, tables and commands included. Sentences and reading ease are of its running text:
Flesch's 206.835 - 1.015 words a sentence - 84.6 syllables a word, with syllables counted as groups of vowels; 30 to 50
are the text of a trade, 60 plain English.
"""

import argparse
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).parents[2]
WRITTEN_BY_PROGRAMS: Final = frozenset({"docs/mismatch.md", "docs/verdict-operating-curve.md"})
LONG_WORDS: Final = 35  # of a sentence
_GENERATED: Final = re.compile(r"<!-- (?!end)[\w -]+ -->.*?<!-- end -->", re.DOTALL)
_CODE: Final = re.compile(r"^( *)```.*?^\1```", re.DOTALL | re.MULTILINE)
_NO_PROSE: Final = re.compile(r"^(?:#| *\||!\[| {4}\S|---).*$", re.MULTILINE)  # headings, tables, pictures, equations
_LINK: Final = re.compile(r"\[([^\]]*)\]\([^)]*\)")
_SENTENCE_END: Final = re.compile(r"(?<=[.!?:])\s+(?=[A-Z`*\[(\d])|\n\s*\n|\n\s*(?:[-*]|\d+\.)\s+")
_WORD: Final = re.compile(r"[A-Za-z][A-Za-z'-]*")
_VOWELS: Final = re.compile(r"[aeiouy]+")


class Readability(NamedTuple):
    """Figures of a text."""

    words: int
    prose_words: int
    sentences: int
    long_sentences: int
    syllables: int

    @property
    def ease(self) -> float:
        """Flesch's reading ease; nan without a sentence."""
        if not self.sentences or not self.prose_words:
            return float("nan")
        return 206.835 - 1.015 * self.prose_words / self.sentences - 84.6 * self.syllables / self.prose_words

    def plus(self, other: "Readability") -> "Readability":
        """Return the figures of both texts."""
        return Readability(*(one + two for one, two in zip(self, other, strict=True)))


NOTHING: Final = Readability(0, 0, 0, 0, 0)


def readability(text: str) -> Readability:
    """Return the figures of a page."""
    own = _GENERATED.sub("", text)
    prose = _LINK.sub(r"\1", _NO_PROSE.sub("", _CODE.sub("", own))).replace("`", "")
    sentences = [words for part in _SENTENCE_END.split(prose) if part and len(words := _WORD.findall(part)) > 1]
    return Readability(
        words=len(own.split()),
        prose_words=sum(map(len, sentences)),
        sentences=len(sentences),
        long_sentences=sum(len(one) > LONG_WORDS for one in sentences),
        syllables=sum(_syllables(word.lower()) for one in sentences for word in one),
    )


def _syllables(word: str) -> int:
    """Return about how many syllables an English word has: a silent e at its end is none."""
    count = len(_VOWELS.findall(word))
    return max(1, count - (word.endswith("e") and not word.endswith("le") and count > 1))


def pages(rev: str | None = None) -> dict[str, str]:
    """Return the pages that people write, by path, as they are or as they were at a revision."""
    if rev is None:
        found = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")]
        names = [str(path.relative_to(ROOT)) for path in (*found, *sorted((ROOT / "docs").glob("*.md")))]
        texts = {name: (ROOT / name).read_text(encoding="utf-8") for name in names}
    else:
        listed = _git("ls-tree", "--name-only", rev, "README.md", "CONTRIBUTING.md", "SECURITY.md", "docs/").split()
        texts = {name: _git("show", f"{rev}:{name}") for name in listed if name.endswith(".md")}
    return {name: text for name, text in texts.items() if name not in WRITTEN_BY_PROGRAMS}


def total(texts: dict[str, str]) -> Readability:
    """Return the figures of all pages together."""
    together = NOTHING
    for text in texts.values():
        together = together.plus(readability(text))
    return together


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rev", help="print the figures of this revision before those of today")
    options = parser.parse_args(arguments)
    now, before = pages(), {} if options.rev is None else pages(options.rev)
    columns = ("words", f"sentences over {LONG_WORDS} words", "reading ease")
    print(f"| page | {' | '.join(columns)} |\n|---|---|---|---|")
    for name in sorted({*now, *before}):
        old = readability(before[name]) if name in before else None
        print(_row(name, old, readability(now[name]) if name in now else NOTHING))
    print(_row("all", total(before) if before else None, total(now)))


def _row(name: str, old: Readability | None, new: Readability) -> str:
    def cell(one: Readability) -> tuple[str, str, str]:
        return f"{one.words:,}", str(one.long_sentences), f"{one.ease:.0f}"

    cells = cell(new) if old is None else tuple(" -> ".join(pair) for pair in zip(cell(old), cell(new), strict=True))
    return f"| {name} | {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
