"""Logs in an S3 store become a lake there by a scheduler and a worker with TLS; nobody else gets in."""

import socket
import ssl
from pathlib import Path

import pytest

from diag_service.errors import ConfigError
from tests.plugins.drives import SHIFT_COUNT
from tests.support.certificates import certify, tls_words
from tests.support.cluster import Cluster
from tests.support.folders import fill_folder
from tests.support.in_process import command
from tests.support.patience import HANG_S
from tests.support.s3 import BUCKET, in_environment, s3_environment, s3_server, store

ONE_DEATH = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}  # of a worker is enough to blame its log


def fill(*words: str) -> None:
    logs, lake = f"s3://{BUCKET}/logs", f"s3://{BUCKET}/lake"
    command("analyze", logs, "--lake", lake, "--vehicle-from", "path", *words)


@pytest.mark.slow
def test_a_lake_in_a_store_is_made_by_a_cluster(
    drive_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fill_folder(tmp_path / "logs" / "car1", drive_log, 2)
    (tmp_path / "logs" / "car1" / "bad.blf").write_bytes(b"LOGG" + bytes(200))
    (tmp_path / "logs" / "car1" / "deadly.log").write_bytes(drive_log.read_bytes())
    with (
        s3_server() as port,
        in_environment(s3_environment(port)),
        Cluster(tmp_path, s3_environment(port) | ONE_DEATH, "tests.support.lakes.deadly") as cluster,
    ):
        cluster.start_scheduler()
        cluster.start_workers("--memory-limit", "700 MiB")
        store(port).put(f"{tmp_path}/logs/", f"{BUCKET}/logs", recursive=True)
        others = tls_words(certify(tmp_path / "others", "node1"), "node1")
        for words, text in {
            ("--scheduler", cluster.address, *others): "CERTIFICATE_VERIFY_FAILED",
            ("--scheduler", cluster.address, *others[2:], *cluster.tls[:2]): "not trusted, or does not trust us",
            ("--scheduler", cluster.address): "needs --ca, --cert and --key",
            ("--scheduler", f"tcp://127.0.0.1:{cluster.port}", *cluster.tls): "by tls://HOST:PORT only",
        }.items():
            with pytest.raises(ConfigError, match=text):
                fill(*words)
        assert no_answer_without_certificate(cluster)
        fill("--scheduler", cluster.address, *cluster.tls)
        assert cluster.listeners() == {"127.0.0.1"}
        said = capsys.readouterr().out
        assert said.count("bad.blf: not analysed; ") == 1
        assert said.count("deadly.log: not analysed; its process died") == 1
        assert f"5 logs: 0 in the lake before, 2 analysed with {2 * SHIFT_COUNT} shifts, 3 not" in said
        before = store(port).find(f"{BUCKET}/lake")
        assert len([name for name in before if "/shifts/date=" in name]) == 2
        fill("--scheduler", cluster.address, *cluster.tls)
        assert "5 logs: 5 in the lake before, 0 analysed" in capsys.readouterr().out
        assert store(port).find(f"{BUCKET}/lake") == before


def no_answer_without_certificate(cluster: Cluster) -> bool:
    """Return whether a scheduler hangs up on who speaks TLS and shows nothing."""
    context = ssl.create_default_context(cafile=cluster.tls[1])
    with socket.create_connection(("127.0.0.1", cluster.port), HANG_S) as plain:
        try:
            with context.wrap_socket(plain, server_hostname="127.0.0.1") as secure:
                return secure.recv(1) == b""
        except OSError:
            return True
