"""The build context: docker's rules of leaving files out, and whether what the Dockerfile copies is left in."""

from pathlib import Path

import pytest

from tests.support.image.context import context_files, is_ignored, read_patterns
from tests.support.image.dockerfile import Copy, read_stages

ROOT = Path(__file__).parents[3]
STAGES = read_stages(ROOT / "Dockerfile")
COPIES = [copy for stage in STAGES for copy in stage.copies if copy.stage is None]


@pytest.mark.parametrize(
    ("lines", "path", "is_out"),
    [  # as the table of moby/patternmatcher's own tests has them
        ("*.go", "matcher.go", True),
        ("*.go", "folder/matcher.go", False),
        ("**/*.go", "a/b/matcher.go", True),
        ("**", "file", True),
        ("**", "folder/file", True),
        ("**/", "folder/file", True),
        ("folder/**", "folder", False),
        ("folder/**", "folder/file", True),
        ("**/file", "file", True),
        ("**/folder/**", "a/folder/b", True),
        ("a**/*.txt", "abc/def.txt", True),
        ("a/*/b", "a/x/b", True),
        ("a/*/b", "a/x/y/b", False),
        ("a[b-d]e", "ace", True),
        ("a[b-d]e", "aae", False),
        ("abc.def", "abcdef", False),
        (r"a\*b", "a*b", True),
        (r"a\*b", "axb", False),
        ("a?c", "abc", True),
        ("a?c", "a/c", False),
        ("/folder", "folder/file", True),
        ("./folder/", "folder/file", True),
        ("folder/../other", "other/file", True),
        ("# comment\nfolder", "folder/file", True),
        ("*\n!folder", "folder/file", False),
        ("*\n!folder", "folder/deep/file", False),
        ("*\n!folder\nfolder/deep", "folder/deep/file", True),
        ("*\n!folder\n**/__pycache__", "folder/__pycache__/x.pyc", True),
        ("*\n!folder/file", "folder/file", False),
        ("*\n!folder/file", "folder/other", True),
        ("!file\n*", "file", True),
        ("folder\n!folder/file\n", "folder/file", False),
        ("*\n!name", "named/file", True),
        ("+a|b", "b", False),
    ],
)
def test_a_file_is_left_out_as_docker_leaves_it_out(lines: str, path: str, *, is_out: bool) -> None:
    assert is_ignored(path, read_patterns(lines)) == is_out


@pytest.mark.parametrize("copy", COPIES, ids=lambda copy: copy.target)
def test_what_the_dockerfile_copies_is_in_the_context(copy: Copy) -> None:
    files = list(context_files(ROOT))
    missing = [name for name in copy.sources if not any(f"{file}/".startswith(f"{name}/") for file in files)]
    assert missing == []


def test_the_context_has_nothing_that_the_dockerfile_does_not_copy() -> None:
    wanted = [name for copy in COPIES for name in copy.sources]
    assert [file for file in context_files(ROOT) if not any(f"{file}/".startswith(f"{name}/") for name in wanted)] == []


def test_a_stage_that_is_copied_from_exists() -> None:
    names = {stage.name for stage in STAGES}
    assert {copy.stage for stage in STAGES for copy in stage.copies} - {None} <= names
