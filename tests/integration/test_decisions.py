"""The index of decisions: every page is in it with its title and status, and what supersedes a page is said on both."""

import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "docs" / "decisions"
PAGES = sorted(FOLDER.glob("[0-9]*.md"))


def status_of(page: Path) -> str:
    found = re.search(r"^\*\*Status:\*\* (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    assert found, f"{page.name} states no status"
    return found[1]


def row_of(page: Path) -> str:
    number, title = re.match(r"# (\d{4}): (.+)\n", page.read_text(encoding="utf-8")).groups()  # type: ignore[union-attr]  # a page without a title fails here
    assert page.name.startswith(f"{number}-")
    return f"| [{number}]({page.name}) | {title} | {status_of(page)} |"


def test_every_page_is_in_the_index_with_its_title_and_status() -> None:
    index = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert [line for line in index.splitlines() if line.startswith("| [")] == [row_of(page) for page in PAGES]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name[:4])
def test_what_supersedes_a_page_is_said_on_both(page: Path) -> None:
    status = status_of(page)
    assert status.startswith(("accepted", "superseded by ["))
    for verb, answer in (("superseded", "supersedes"), ("supersedes", "superseded")):
        for clause in re.findall(rf"{verb} .*?(?=;|, keeps|, adds|, supersedes|$)", status):
            for name in re.findall(r"\]\((\d{4}-[\w-]+\.md)\)", clause):
                other = status_of(FOLDER / name)
                assert answer in other, f"{page.name} and {name} disagree"
                assert f"]({page.name})" in other, f"{page.name} and {name} disagree"
