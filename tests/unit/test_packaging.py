"""What the distribution promises: names, versions, a lock without machines, documents whose links lead somewhere."""

import importlib
import re
from pathlib import Path
from types import ModuleType

import pytest

import ecu_emulator
from tests.support.distributions import FOLDERS, PACKAGES, ROOT, SOURCES, extras_of, pyproject, requirements

SUBPACKAGES = sorted(
    ".".join((package, *path.parent.relative_to(folder).parts))
    for package, folder in PACKAGES.items()
    for path in folder.rglob("__init__.py")
)
DOCUMENTS = sorted(
    [*(path for folder in FOLDERS.values() for path in folder.glob("*.md")), *(ROOT / "docs").rglob("*.md")]
)
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
PIN = re.compile(r"([a-z0-9][a-z0-9._-]*)==([^ ]+)( ; [^\\]+)? \\")


LOCKS = ("requirements.lock", "requirements-demo.lock")


def lock_lines(name: str = "requirements.lock") -> list[str]:
    return (ROOT / name).read_text(encoding="utf-8").splitlines()


def locked(name: str) -> dict[tuple[str, str], frozenset[str]]:
    """Return the hashes of a lock by name and version."""
    found: dict[tuple[str, str], frozenset[str]] = {}
    for entry in re.split(r"\n(?=[a-z0-9])", "\n".join(lock_lines(name)))[1:]:
        pin = PIN.match(entry)
        assert pin is not None, entry
        found[normal(pin[1]), pin[2]] = frozenset(re.findall(r"--hash=(\S+)", entry))
    return found


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


@pytest.mark.parametrize("name", SUBPACKAGES)
def test_a_package_exports_exactly_its_public_names(name: str) -> None:
    package = importlib.import_module(name)
    exported = getattr(package, "__all__", [])
    assert [entry for entry in exported if not hasattr(package, entry)] == []  # some appear when they are asked for
    public = [
        entry
        for entry, value in vars(package).items()
        if not entry.startswith("_") and not isinstance(value, ModuleType)
    ]
    assert len(exported) == len(set(exported))  # their order is ruff's
    assert {entry for entry in exported if not entry.startswith("__")} == set(public)


@pytest.mark.parametrize("lock", LOCKS)
def test_the_lock_names_no_machine(lock: str) -> None:
    text = "\n".join(lock_lines(lock))
    assert re.findall(r"https?://|file:|--(?:extra-)?index-url|--find-links|--trusted-host", text) == []
    assert re.findall(r"(?:^|\s)(?:/|~|[A-Z]:\\)\S+", text) == []


def test_the_lock_holds_every_direct_requirement() -> None:
    wanted = [text for name in FOLDERS for text in requirements(name, *extras_of(name))]
    names = {normal(re.split(r"[<>=!~;\[ ]", entry, maxsplit=1)[0]) for entry in wanted}
    locked = {normal(match[1]) for line in lock_lines() if (match := PIN.fullmatch(line))}
    assert names - locked == set()


def test_the_locks_agree_and_the_small_one_has_what_runs_and_shows() -> None:
    everything, small = (locked(name) for name in LOCKS)
    assert [pinned for pinned, hashes in small.items() if everything.get(pinned) != hashes] == []
    wanted = {*requirements("clutchdiag", "demo"), *requirements("canlog")}
    assert {normal(re.split(r"[<>=!~;\[ ]", one, maxsplit=1)[0]) for one in wanted} <= {name for name, _ in small}
    assert not {"mypy", "pytest", "polars", "pyarrow", "playwright"} & {name for name, _ in small}


def test_every_distribution_has_the_version_of_the_core() -> None:
    versions = {pyproject(name)["project"]["version"] for name in FOLDERS}
    image = re.search(r"image: clutchdiag:(\S+)", (ROOT / "docker-compose.yml").read_text(encoding="utf-8"))
    assert image is not None
    assert {image[1], ecu_emulator.__version__} == versions


def anchors(document: Path) -> set[str]:
    """Return the anchors that common renderers give a document's headings."""
    headings = HEADING.findall(document.read_text(encoding="utf-8"))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(document: Path) -> None:
    for link in LINK.findall(document.read_text(encoding="utf-8")):
        if link.startswith(("http://", "https://")):
            continue
        path, _, anchor = link.partition("#")
        target = document.parent / path if path else document
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_named_in_the_text_exist(document: Path) -> None:
    folders = "|".join((*PACKAGES, "docs", "tests"))
    named = re.findall(rf"`((?:{folders})/[\w./-]*)`", document.read_text(encoding="utf-8"))
    places = (ROOT, *SOURCES.values())
    assert [name for name in named if not any((place / name).exists() for place in places)] == []


def test_the_model_numbers_every_equation_of_the_source() -> None:
    text = (ROOT / "docs" / "model.md").read_text(encoding="utf-8")
    assert [number for number in range(1, 19) if f"| ({number}) |" not in text] == []


@pytest.mark.parametrize("name", FOLDERS)
def test_every_package_data_pattern_matches_a_file(name: str) -> None:
    patterns = pyproject(name)["tool"]["setuptools"]["package-data"]
    unmatched = [
        f"{package}/{pattern}"
        for package, entries in patterns.items()
        for pattern in entries
        if not any(PACKAGES[package].glob(pattern))
    ]
    assert unmatched == []


@pytest.mark.parametrize("name", FOLDERS)
def test_every_distribution_has_the_licence(name: str) -> None:
    assert (FOLDERS[name] / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
