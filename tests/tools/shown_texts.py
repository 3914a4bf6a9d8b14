"""Every text that a program may show, in one list, and which of them break a rule of plain English.

Run it as ``python -m tests.tools.shown_texts`` to read all of them, one a line with its place. With ``--findings``
it shows only those that break a rule of ``RULES``. A value that is put in at run time stands as ``{name}``.
"""

import argparse
import ast
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = (
    "canlog",
    "clutch_model",
    "dbc",
    "diag_service",
    "ecu_emulator",
    "fleet_backend",
    "fleet_contract",
    "fleet_link",
    "clutchdiag_io",
)
EARLIER = "_EARLIER"  # so begin the names of texts of earlier versions, which are read and not shown
_MAX_WORDS = 32
_WORDS = re.compile(r"[A-Za-z]{2,}[,;:]? [A-Za-z({]")
_CODE = re.compile(
    r"\b(SELECT|INSERT|CREATE|UPDATE|DELETE FROM|ALTER|PRAGMA|DROP|BEGIN|WHERE|CASE|LOCK|SET) |^\s*[.#@]?[\w-]+ *\{"
)
_SENTENCE_END = re.compile(r"(?<=[.!?])\s+|\n\n|; ")
_PUT_IN = re.compile(r"\{.*?\}")
_MARKUP = re.compile(r"<script.*?</script>|\{%.*?%\}|\{#.*?#\}|<[^>]*>", re.DOTALL)

# What made somebody read a sentence twice, and how to say it instead.
RULES = {
    r"\bits fluid lets it\b": "name the effect: 'the fluid causes shudder'",
    r"\bnever said\b": "say what is known: 'no message received yet'",
    r"^(Half|Most) by\b": "name the quantity: '50 % likely due by'",
    r"\bfollow each other\b": "say what happens: 'one alarm per vehicle and rule is open at a time'",
    r"^Nothing in the fleet\b": "say what was looked for: 'No vehicle matches this filter.'",
    r"\bprobability (0|1)\.0+\b": "give the certainty: 'over 99 % sure'",
    r"% of (its|the) margin .* (are|is) gone": "subject first: 'half of the margin against shudder is used up'",
    r"^(Never|Nowhere|Neither|Nor|Seldom|Rarely|Only then)\b": "subject first",
    r"\b(is|are|was) to be had\b": "'is available'",
    r"\bwhereabouts\b|\bwherewith\b|\bthereof\b|\btherein\b|\bthat one's\b": "the noun itself",
    r"\bwith a probability\b": "'likely', with its figure",
    r"(?<!-)\b([a-z]{3,}) \1 ": "a word stands twice",
    r"(?<!there )(?<!There )\b(is|are) no (?!longer|more|fault)[a-z]": "'is not a ...'",
    r"\b(its|their) own end\b": "'is cut off'",
    r"\bwhoever\b|\bnobody can say\b|\bso may you\b|\bsomebody does\b": "name the person or program",
    r"\bthe same command goes on\b": "'run the same command again to continue'",
    r"\b1 (shifts|events|frames|values|lines|files|logs|results|vehicles)\b": "one thing has no plural",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ShownText:
    """A text as it stands in the source, with the names of what is put in."""

    path: str
    line: int
    text: str

    def findings(self) -> Iterator[str]:
        """Yield what plain English has against this text."""
        for pattern, instead in RULES.items():
            if found := re.search(pattern, self.text, re.MULTILINE):
                yield f"'{found.group()}': {instead}"
        for sentence in _SENTENCE_END.split(self.text):
            count = len(re.findall(r"[A-Za-z]{2,}", _PUT_IN.sub("", sentence)))
            if count > _MAX_WORDS:
                yield f"a sentence of {count} words, at most {_MAX_WORDS}: '{' '.join(sentence.split()[:6])} ...'"


def shown_texts(packages: Sequence[str] = PACKAGES) -> list[ShownText]:
    """Return all texts of two words or more that are no docstring, comment, query or style, by place."""
    texts: list[ShownText] = []
    for package in packages:
        for path in sorted((ROOT / package).rglob("*")):
            place = str(path.relative_to(ROOT))
            if path.suffix == ".py":
                texts.extend(_texts_of_module(place, path.read_text("utf-8")))
            elif path.suffix in {".html", ".toml"}:
                texts.extend(_texts_of_lines(place, path.read_text("utf-8"), is_page=path.suffix == ".html"))
    return texts


def _texts_of_module(place: str, source: str) -> Iterator[ShownText]:
    tree = ast.parse(source)
    docstrings = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    only_read = {
        id(part)
        for node in ast.walk(tree)
        if isinstance(node, ast.AnnAssign) and ast.unparse(node.target).startswith(EARLIER)
        for part in ast.walk(node)
    }
    parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            text = _joined(node)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) in docstrings | parts | only_read:
                continue
            text = node.value
        else:
            continue
        if _WORDS.search(text) and not _CODE.search(text):
            yield ShownText(path=place, line=node.lineno, text=text)


def _joined(node: ast.JoinedStr) -> str:
    return "".join(
        str(part.value) if isinstance(part, ast.Constant) else "{" + ast.unparse(part.value)[:40] + "}"
        for part in node.values
        if isinstance(part, ast.Constant | ast.FormattedValue)
    )


def _texts_of_lines(place: str, source: str, *, is_page: bool) -> Iterator[ShownText]:
    for number, line in enumerate(source.splitlines(), 1):
        text = (
            _MARKUP.sub(" ", line)
            if is_page
            else "".join(re.findall(r'^(?:title|text|description)\s*=\s*"(.*)"', line))
        )
        text = re.sub(r"\{\{(.*?)\}\}", r"{\1}", text).strip()
        if _WORDS.search(text):
            yield ShownText(path=place, line=number, text=text)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the list, or what is found against it; return 1 if something is."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("packages", nargs="*", default=PACKAGES)
    parser.add_argument("--findings", action="store_true", help="only texts that break a rule")
    chosen = parser.parse_args(arguments)
    texts = shown_texts(chosen.packages)
    found = 0
    for text in texts:
        against = list(text.findings())
        found += len(against)
        if against or not chosen.findings:
            sys.stdout.write(f"{text.path}:{text.line}: {' '.join(text.text.split())}\n")
            sys.stdout.writelines(f"    ! {finding}\n" for finding in against)
    sys.stdout.write(f"{len(texts)} texts, {found} findings\n")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
