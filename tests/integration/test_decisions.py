"""The decisions: few short pages, titled by subject and choice, all in the index; no reference leads nowhere."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "decisions"
INDEX = (FOLDER / "README.md").read_text(encoding="utf-8")
PAGES = sorted(FOLDER.glob("[0-9]*.md"))
NUMBERS = {page.name[:4] for page in PAGES}
MOST_PAGES, MOST_WORDS = 20, 200
HEADINGS = ["Context", "Decision", "Consequences"]
REFERENCE = re.compile(r"\b[Dd]ecisions?\s\[?\d{4}\b(?:(?:, | and )\d{4}\b)*|decisions/\d{4}-")


def row_of(page: Path) -> str:
    number, title = re.match(r"# (\d{4}): (.+)\n", page.read_text(encoding="utf-8")).groups()  # type: ignore[union-attr]  # a page without a title fails here
    assert page.name.startswith(f"{number}-")
    return f"| [{number}]({page.name}) | {title} |"


def test_there_are_few_pages_and_all_are_in_the_index_with_their_titles() -> None:
    assert len(NUMBERS) == len(PAGES) <= MOST_PAGES
    assert [line for line in INDEX.splitlines() if line.startswith("| [")] == [row_of(page) for page in PAGES]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name[:4])
def test_a_page_says_its_subject_and_choice_and_then_why_in_few_words(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert re.match(r"# \d{4}: [^:\n]+: [^:\n]+\n", text)
    assert re.findall(r"^## (.+)$", text, re.MULTILINE) == HEADINGS
    assert sum(any(map(str.isalnum, word)) for word in text.split()) <= MOST_WORDS


def test_no_reference_names_a_page_that_is_gone() -> None:
    folders = [
        folder for folder in ROOT.iterdir() if folder.is_dir() and folder.name[0] != "." and folder.name != "build"
    ]
    files = [
        *ROOT.glob("*.md"),
        *(path for folder in folders for kind in ("*.md", "*.py") for path in folder.rglob(kind)),
    ]
    dangling = {
        f"{path.relative_to(ROOT)}: {number}"
        for path in files
        for reference in REFERENCE.finditer(path.read_text(encoding="utf-8"))
        for number in re.findall(r"\d{4}", reference[0])
        if number not in NUMBERS
    }
    assert dangling == set()
