"""Files of which a library is going to read all are looked at before: they must be plain, and not too large."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from clutch_model.tables import read_toml_file
from clutchdiag_io.files import check_plain_file
from tests.support.pipes import NO_PLAIN_FILES


@pytest.mark.parametrize("use", [check_plain_file, read_toml_file])
@pytest.mark.parametrize("kind", NO_PLAIN_FILES)
def test_what_is_no_file_is_refused_at_once(kind: str, use: Callable[[Path], object], tmp_path: Path) -> None:
    path = tmp_path / "it"
    NO_PLAIN_FILES[kind](path)
    with pytest.raises(OSError, match=kind):
        use(path)


@pytest.mark.parametrize("use", [check_plain_file, read_toml_file])
def test_sizes_are_limited(use: Callable[[Path], object], tmp_path: Path) -> None:
    path = tmp_path / "it"
    path.write_bytes(b"a = 1")
    use(path)
    os.truncate(path, 2**30)
    with pytest.raises(OSError, match="too large"):
        use(path)


@pytest.mark.parametrize("use", [check_plain_file, read_toml_file])
def test_the_null_device_is_an_empty_file(use: Callable[[Path], object]) -> None:
    use(Path(os.devnull))
