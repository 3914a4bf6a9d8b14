"""The example of a proxy that logs people in, played with a real nginx in front of the fleet's page."""

import shutil
import socket
import ssl
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from fleet_backend.page.access import read_access
from tests.support.documents import page_text
from tests.support.fleet_page import SECRET, filled, served
from tests.support.patience import HANG_S
from tests.support.ports import free_port

NAME, PASSWORD = "workshop@example.org", "a word of four"
HOST = "fleet.example.org"


def openssl(*words: str) -> str:
    return subprocess.run(["openssl", *words], check=True, capture_output=True, text=True).stdout


@contextmanager
def nginx(folder: Path, page: str, port: int) -> Iterator[None]:
    """Run nginx with the file of the example: its paths and ports are this test's, the rest is as shown."""
    key, certificate = folder / "fleet.key", folder / "fleet.crt"
    subject = ["-subj", f"/CN={HOST}", "-keyout", str(key), "-out", str(certificate), "-days", "1"]
    openssl("req", "-x509", "-newkey", "rsa:2048", "-nodes", *subject)
    (folder / "fleet.users").write_text(f"{NAME}:{openssl('passwd', '-apr1', PASSWORD)}", encoding="ascii")
    (folder / "fleet.secret").write_text(f'proxy_set_header X-Fleet-Proxy "{SECRET}";\n', encoding="ascii")
    server = page_text("docs/deploy/nginx-login.conf").replace("/etc/nginx", str(folder))
    server = server.replace("listen 443", f"listen 127.0.0.1:{port}").replace("http://127.0.0.1:8090", page)
    text = f"daemon off; master_process off; pid {folder}/pid; events {{}} http {{ access_log off; {server} }}"
    (folder / "nginx.conf").write_text(text, encoding="utf-8")
    program = shutil.which("nginx", path="/usr/sbin:/usr/bin:/usr/local/sbin")
    assert program is not None, "nginx is not installed (Debian package nginx-light)"
    log = folder / "error.log"
    process = subprocess.Popen([program, "-c", str(folder / "nginx.conf"), "-e", str(log), "-p", str(folder)])
    try:
        deadline_s = time.monotonic() + HANG_S
        while socket.socket().connect_ex(("127.0.0.1", port)) != 0:
            is_late = process.poll() is not None or time.monotonic() > deadline_s
            assert not is_late, log.read_text(encoding="utf-8")
            time.sleep(0.02)
        yield
    finally:
        process.terminate()
        process.wait(HANG_S)


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # of sockets that only ask whether nginx listens
def test_people_come_through_the_proxy_alone(sqlite_template: Path, tmp_path: Path) -> None:
    database = filled(sqlite_template, tmp_path)
    (tmp_path / "proxy.secret").write_text(SECRET, encoding="utf-8")
    (tmp_path / "proxy.secret").chmod(0o600)
    (tmp_path / "access.toml").write_text(page_text("docs/deploy/access-proxy.toml"), encoding="utf-8")
    access, port = read_access(tmp_path / "access.toml"), free_port()
    with served(database, access) as page, nginx(tmp_path, page, port):
        certificates = ssl.create_default_context(cafile=tmp_path / "fleet.crt")
        certificates.check_hostname = False  # it is of the name that readers would call
        address, headers = f"https://127.0.0.1:{port}", {"Host": HOST}
        with httpx.Client(base_url=address, verify=certificates, headers=headers, trust_env=False) as client:
            assert client.get("/").status_code == 401
            assert client.get("/", auth=(NAME, "another word")).status_code == 401
            forged = {"X-Forwarded-User": "ann@example.org"}
            shown = client.get("/", auth=(NAME, PASSWORD), headers=forged)
            assert (shown.status_code, NAME in shown.text, "ann@" in shown.text) == (200, True, False)
        past = httpx.get(page, headers={"Host": HOST, "X-Forwarded-User": NAME}, trust_env=False)
        assert past.status_code == 401
