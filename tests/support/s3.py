"""An S3 server of a process of its own, on a free loopback port, with its objects in memory."""

import os
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import fsspec

from tests.support.patience import HANG_S
from tests.support.ports import free_port

BUCKET = "fleet"
_POLL_S = 0.02
_PROGRAM = "import sys; from moto.server import main; main(sys.argv[1:])"


def s3_environment(port: int) -> dict[str, str]:
    """Return what tells programs where the store is, and who they are to it."""
    return {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
        "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "testing",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_EC2_METADATA_DISABLED": "true",
    }


@contextmanager
def s3_server() -> Iterator[int]:
    """Run a server with an empty bucket; yield its port."""
    port = free_port()
    command = [sys.executable, "-c", _PROGRAM, "-H", "127.0.0.1", "-p", str(port)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        try:
            _wait_for(port)
            yield port
        finally:
            server.kill()


@contextmanager
def in_environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set variables of this process for a while."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    fsspec.get_filesystem_class("s3").clear_instance_cache()  # one that is open keeps its server
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _wait_for(port: int) -> None:
    """Make the bucket as soon as the server answers."""
    deadline_s = time.monotonic() + HANG_S
    while True:
        try:
            request = urllib.request.Request(f"http://127.0.0.1:{port}/{BUCKET}", method="PUT")
            urllib.request.urlopen(request).close()  # noqa: S310 - the server that was just started
        except (OSError, urllib.error.URLError):
            if time.monotonic() > deadline_s:
                raise
            time.sleep(_POLL_S)
        else:
            return


def store(port: int) -> Any:  # noqa: ANN401 - an untyped library
    """Return the store as files, past everything of ours; the environment says who we are."""
    return fsspec.filesystem(
        "s3", endpoint_url=f"http://127.0.0.1:{port}", use_listings_cache=False, skip_instance_cache=True
    )
