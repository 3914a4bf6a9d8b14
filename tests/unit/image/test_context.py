"""The build context: docker's rules of leaving files out, and whether what the Dockerfile copies is left in."""

from pathlib import Path

import pytest

from tests.support.image.context import context_files
from tests.support.image.dockerfile import Copy, read_stages

ROOT = Path(__file__).parents[3]
STAGES = read_stages(ROOT / "Dockerfile")
COPIES = [copy for stage in STAGES for copy in stage.copies if copy.stage is None]


@pytest.mark.parametrize("copy", COPIES, ids=lambda copy: copy.target)
def test_what_the_dockerfile_copies_is_in_the_context(copy: Copy) -> None:
    files = list(context_files(ROOT))
    missing = [name for name in copy.sources if not any(f"{file}/".startswith(f"{name}/") for file in files)]
    assert missing == []


def test_the_context_has_nothing_that_the_dockerfile_does_not_copy() -> None:
    wanted = [name for copy in COPIES for name in copy.sources]
    assert [file for file in context_files(ROOT) if not any(f"{file}/".startswith(f"{name}/") for name in wanted)] == []
