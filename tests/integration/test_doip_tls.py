"""DoIP by TLS and by IPv6: our tester against our entity, with certificates made for it, and those who get it wrong."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.certificates import certify
from tests.support.doip.tester import entity
from tests.support.in_process import ended
from tests.support.ports import free_port
from workshop.controller.doip_server import DoipServer, TlsNode
from workshop.controller.memory import TestResult as Result

SLIPS = 0x081107
PATIENT = ("--ecu", "1011", "--active", "--listen", "0", "--timeout", "20")


@pytest.fixture(name="folder", scope="module")
def _folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the certificate of a node, one in a single file with its key, and two authorities."""
    folder, other = certify(tmp_path_factory.mktemp("tls"), "node1"), certify(tmp_path_factory.mktemp("other"))
    (folder / "both.pem").write_bytes((folder / "node1.crt").read_bytes() + (folder / "node1.key").read_bytes())
    (folder / "other.crt").write_bytes((other / "ca.crt").read_bytes())
    return folder


@pytest.fixture(name="node", scope="module")
def _node(folder: Path) -> Iterator[DoipServer]:
    tls = TlsNode(certificate=folder / "both.pem", key=None, port=free_port())
    with entity(tls=tls) as (controller, server):
        for _ in range(20):
            controller.report(SLIPS, Result.FAILED)
        yield server


def tls_port(node: DoipServer) -> int:
    assert node.place.tls is not None
    return node.place.tls.port


def codes_at(place: str, *more: str) -> list[str]:
    done = ended("dtc", "--doip", place, *PATIENT, "--brief", "--json", *more)
    assert done.status == 0, done.err
    return [code["code"] for code in done.records[0]["codes"]]


def test_the_same_codes_come_by_tls_and_without(node: DoipServer, folder: Path) -> None:
    by_tls = codes_at(f"127.0.0.1:{tls_port(node)}", "--doip-authority", str(folder / "ca.crt"))
    assert by_tls == codes_at(str(node.place)) == ["P0811"]


def test_a_node_that_another_authority_knows_is_not_asked(node: DoipServer, folder: Path) -> None:
    words = ("dtc", "--doip", f"127.0.0.1:{tls_port(node)}", *PATIENT, "--doip-authority")
    ended(*words, folder / "other.crt").assert_one_line(3, "certificate verify failed")
    ended(*words, folder / "ca.key").assert_one_line(2, "is no certificate")
    ended(*words, folder / "missing").assert_one_line(2, "cannot read authority")
