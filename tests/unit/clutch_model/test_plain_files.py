"""Files that are read whole are plain and small, or an error; nothing is waited for that nobody promised."""

import os
import socket
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from clutch_model import plain_files
from clutch_model.plain_files import check_plain_file, read_small_file, read_toml_file


def a_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))


OTHERS: Mapping[str, Callable[[Path], None]] = {
    "pipe": os.mkfifo,
    "directory": Path.mkdir,
    "socket": a_socket,
    "device": lambda path: path.symlink_to("/dev/zero"),
}


@pytest.mark.parametrize("kind", OTHERS)
def test_what_is_no_file_is_refused_at_once(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "it"
    OTHERS[kind](path)
    for use in (read_small_file, check_plain_file, lambda it: read_toml_file(it, takes_pipes=False)):
        with pytest.raises(OSError, match=kind):
            use(path)


def test_sizes_are_limited_whatever_the_file_system_says(tmp_path: Path) -> None:
    path = tmp_path / "it"
    path.write_bytes(b"12345")
    assert read_small_file(path, 5) == b"12345"
    for use in (read_small_file, check_plain_file):
        with pytest.raises(OSError, match="too large"):
            use(path, 4)
    assert b"Name:" in read_small_file(Path("/proc/self/status"))  # which claims to have no bytes
    with pytest.raises(OSError, match="too large"):
        read_small_file(Path("/proc/self/status"), 4)


def test_the_null_device_is_an_empty_file() -> None:
    assert read_toml_file(Path(os.devnull)) == {}


def test_a_pipe_is_read_while_something_comes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    writer = threading.Thread(target=lambda: path.write_bytes(b"a = 1\n"))
    writer.start()
    assert read_toml_file(path) == {"a": 1}
    writer.join()
    monkeypatch.setattr(plain_files, "PIPE_WAIT_S", 0.01)
    with pytest.raises(OSError, match="nobody has written into this pipe"):
        read_small_file(path, takes_pipes=True)


def test_a_pipe_without_an_end_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)

    def write() -> None:
        with pytest.raises(BrokenPipeError):
            path.write_bytes(bytes(2**20))

    writer = threading.Thread(target=write)
    writer.start()
    with pytest.raises(OSError, match="too large"):
        read_small_file(path, 1_000, takes_pipes=True)
    writer.join()


@pytest.mark.parametrize("text", ["a = ", "a = " + "[" * 100_000, "a = " + "{a = " * 50_000])
def test_no_toml_is_a_value_error(text: str, tmp_path: Path) -> None:
    path = tmp_path / "it"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"nested|Invalid|line"):
        read_toml_file(path)
