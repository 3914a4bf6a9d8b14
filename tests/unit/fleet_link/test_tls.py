"""Certificate files: read anew, checked for who may read the key, and a renewal noticed."""

import os
import threading
from pathlib import Path

import pytest

from fleet_link import AddressError, TlsFiles, read_secret
from tests.support.certificates import certify, tls_files


@pytest.fixture(name="files")
def _files(tmp_path: Path) -> TlsFiles:
    return tls_files(certify(tmp_path, "car1"), "car1")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder: (folder / "car1.key").chmod(0o640), "chmod 600"),
        (lambda folder: (folder / "car1.key").unlink(), "cannot read"),
        (lambda folder: (folder / "ca.crt").unlink(), "cannot be read"),
        (lambda folder: (folder / "ca.crt").write_bytes(b"x"), "cannot be used"),
        (lambda folder: (folder / "car1.crt").write_bytes((folder / "ca.crt").read_bytes()), "cannot be used"),
    ],
)
def test_files_that_may_be_put_right_are_a_matter_of_patience(
    files: TlsFiles, tmp_path: Path, spoil: "object", message: str
) -> None:
    assert callable(spoil)
    spoil(tmp_path)
    files.fingerprint()
    with pytest.raises(AddressError, match=message):
        files.context()


def test_a_secret_may_come_through_a_pipe(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path, 0o600)
    writer = threading.Thread(target=lambda: path.write_bytes(b"open sesame\n"))
    writer.start()
    assert read_secret(path) == "open sesame"
    writer.join()
    with pytest.raises(AddressError, match="nobody has written into this pipe"):
        read_secret(path, pipe_wait_s=0.01)


def test_a_key_that_others_may_read_is_taken_only_by_whoever_says_so(files: TlsFiles, tmp_path: Path) -> None:
    (tmp_path / "car1.key").chmod(0o644)
    assert files.context(is_key_private=False).check_hostname
    with pytest.raises(AddressError, match="chmod 600"):
        files.context()
