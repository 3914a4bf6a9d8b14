"""The service from one settings file: mutual TLS to a real Mosquitto, a backend that acknowledges, no secret said."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from diag_service.store import ResultStore
from tests.plugins.broker import Mosquitto
from tests.support.acknowledger import Acknowledger
from tests.support.certificates import certify
from tests.support.in_process import ended as run

pytestmark = pytest.mark.broker


@pytest.fixture(name="certificates")
def _certificates(tmp_path: Path) -> Path:
    return certify(tmp_path / "certificates", "broker", "car1", "fleet-backend")


@pytest.fixture(name="broker")
def _broker(tmp_path: Path, certificates: Path) -> Iterator[Mosquitto]:
    folder = tmp_path / "mosquitto"
    folder.mkdir()
    lines = [f"{key} {certificates / name}" for key, name in (("cafile", "ca.crt"), ("certfile", "broker.crt"))]
    broker = Mosquitto(folder, (*lines, f"keyfile {certificates}/broker.key", "require_certificate true"))
    broker.start()
    yield broker
    broker.stop()


def test_an_analysis_from_a_settings_file(
    tmp_path: Path, cycle_log: Path, broker: Mosquitto, certificates: Path
) -> None:
    settings, store = tmp_path / "car1.toml", tmp_path / "car1.sqlite"
    settings.write_text(
        f"""vehicle = "car1"
broker = "mqtts://car1:hunter2@127.0.0.1:{broker.port}"
ca = "{certificates}/ca.crt"
cert = "{certificates}/car1.crt"
key = "{certificates}/car1.key"
acknowledge = "backend"
store = "{store}"
""",
        encoding="utf-8",
    )
    settings.chmod(0o600)
    backend = tuple(str(certificates / name) for name in ("ca.crt", "fleet-backend.crt", "fleet-backend.key"))
    with Acknowledger(broker.port, tls=(backend[0], backend[1], backend[2])) as hearing:
        checked = run("config", "check", "--config", settings)
        ended = run("analyze", cycle_log, "--json", "--config", settings)
    assert (checked.status, ended.status) == (0, 0), checked.err + ended.err
    assert ended.summary["shifts"]["unpublished"] == 0
    assert hearing.seqs() == {int(shift["seq"]) for shift in ended.shifts}
    assert "hunter2" not in checked.out + checked.err + ended.out + ended.err
    opened = ResultStore.open(store)
    assert len(list(opened.results("car1"))) == len(ended.shifts)
    opened.close()
