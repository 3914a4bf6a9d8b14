"""The decisions: few pages, titled by subject and choice, all in the index; earlier numbers lead to one."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "decisions"
INDEX = (FOLDER / "README.md").read_text(encoding="utf-8")
PAGES = sorted(FOLDER.glob("[0-9]*.md"))
NUMBERS = {page.name[:4] for page in PAGES}
MOST_PAGES = 45
NEVER_USED = {"0052", "0086", "0089", "0092", "0093"}
LAST_EARLIER = 98  # a later number goes only if a page of its own went
HEADINGS = ["Context", "Decision", "Consequences"]
REFERENCE = re.compile(r"\b[Dd]ecisions?\s\[?\d{4}\b(?:(?:, | and )\d{4}\b)*|decisions/\d{4}-")


def earlier_numbers() -> dict[str, list[str]]:
    table = INDEX.partition("## Earlier numbers\n")[2]
    return {
        number: re.findall(r"\[(\d{4})\]\(\1-[a-z-]+\.md\)", pages)
        for number, pages in re.findall(r"^\| (\d{4}) \| (.+) \|$", table, re.MULTILINE)
    }


def row_of(page: Path) -> str:
    text = page.read_text(encoding="utf-8")
    number, title = re.match(r"# (\d{4}): (.+)\n", text).groups()  # type: ignore[union-attr]  # a page without a title fails here
    status = re.search(r"^\*\*Status:\*\* (.+)$", text, re.MULTILINE)
    assert page.name.startswith(f"{number}-")
    assert status, f"{page.name} states no status"
    return f"| [{number}]({page.name}) | {title} | {status[1]} |"


def test_there_are_few_pages() -> None:
    assert len(PAGES) <= MOST_PAGES
    assert len(NUMBERS) == len(PAGES)


def test_every_page_is_in_the_index_with_its_title_and_status() -> None:
    assert [line for line in INDEX.splitlines() if line.startswith("| [")] == [row_of(page) for page in PAGES]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name[:4])
def test_a_page_says_its_subject_and_choice_and_then_why(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert re.match(r"# \d{4}: [^:\n]+: [^:\n]+\n", text)
    headings = re.findall(r"^## (.+)$", text, re.MULTILINE)
    assert headings[:3] == HEADINGS
    assert headings[3:] in ([], ["Considered and left"], ["Earlier"])


def test_every_number_that_is_gone_leads_to_a_page() -> None:
    earlier = earlier_numbers()
    assert not NUMBERS & earlier.keys()
    assert list(earlier) == sorted(earlier)
    gone = {f"{number:04}" for number in range(1, LAST_EARLIER + 1)} - NUMBERS - NEVER_USED
    assert earlier.keys() >= gone
    assert all(pages and NUMBERS.issuperset(pages) for pages in earlier.values())


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
