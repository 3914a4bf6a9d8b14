"""Mutual TLS with a real Mosquitto under the configuration of docs/deploy: who is refused, who is told, what stays."""

from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, closing
from dataclasses import replace
from pathlib import Path

import pytest

from clutch_results.records import shift_record
from diag_service.delivery import Acknowledge, DeliveryLimits, MqttConnector, Outbox
from diag_service.store import ResultStore
from fleet_backend import queries
from fleet_backend.choices import TrendAxis
from fleet_backend.database import open_database
from fleet_contract import shift_message
from fleet_link import BrokerAddress, TlsFiles
from tests.plugins.broker import Mosquitto
from tests.support.acknowledger import Acknowledger
from tests.support.builders import shift_result
from tests.support.certificates import certify, expire, tls_files, tls_words
from tests.support.fleet_broker import fleet_broker
from tests.support.fleet_worker import worker
from tests.support.outboxes import NOW, put, sending, until

pytestmark = pytest.mark.broker

QUICK = DeliveryLimits(first_pause_s=0.05, longest_pause_s=0.2)
ALARM_S = 60.0  # within which somebody has to know


@pytest.fixture(name="certificates")
def _certificates(tmp_path: Path) -> Path:
    return certify(tmp_path / "certificates", "broker", "car1", "car2", "fleet-backend")


@pytest.fixture(name="broker")
def _broker(tmp_path: Path, certificates: Path) -> Iterator[Mosquitto]:
    broker = fleet_broker(tmp_path / "mosquitto", certificates)
    broker.start()
    yield broker
    broker.stop()


@pytest.fixture(name="store")
def _store() -> Iterator[ResultStore]:
    with closing(ResultStore.in_memory()) as store:
        yield store


@asynccontextmanager
async def running(
    store: ResultStore, broker: Mosquitto, tls: TlsFiles, *, host: str = "127.0.0.1", vehicle: str = "car1"
) -> AsyncIterator[Outbox]:
    address = BrokerAddress(host=host, port=broker.port, tls=tls)
    connector = MqttConnector(address, f"clutchdiag-{vehicle}", is_persistent=True, renewal_period_s=0.1)
    outbox = Outbox(
        store, vehicle, lambda: connector.connect(NOW), str(address), acknowledge=Acknowledge.BACKEND, limits=QUICK
    )
    async with sending(outbox):
        yield outbox


def backend(certificates: Path, broker: Mosquitto) -> Acknowledger:
    _, ca, _, certificate, _, key = tls_words(certificates, "fleet-backend")
    return Acknowledger(broker.port, tls=(ca, certificate, key))


@pytest.mark.parametrize(
    ("name", "host", "alarm"),
    [
        pytest.param(None, "127.0.0.1", "certificate required", id="no certificate"),
        pytest.param("late", "127.0.0.1", "certificate expired", id="expired certificate"),
        pytest.param("car1", "localhost", "certificate is not valid for 'localhost'", id="wrong host"),
    ],
)
async def test_who_has_no_business_is_refused_told_and_loses_nothing(
    store: ResultStore,
    broker: Mosquitto,
    certificates: Path,
    caplog: pytest.LogCaptureFixture,
    name: str | None,
    host: str,
    alarm: str,
) -> None:
    if name == "late":
        expire(certify(certificates, name), name)
    put(store, [1, 2])
    with backend(certificates, broker) as hearing:
        async with running(store, broker, tls_files(certificates, name), host=host):
            await until(lambda: "2 results wait in the store" in caplog.text, ALARM_S)
        assert alarm in caplog.text
        assert hearing.seqs() == set()
        async with running(store, broker, tls_files(certificates, "car1")):  # put right
            await until(lambda: store.unpublished_count("car1") == 0)
    assert hearing.seqs() == {1, 2}


async def test_an_expired_certificate_is_renewed_without_a_restart(
    store: ResultStore, broker: Mosquitto, certificates: Path, caplog: pytest.LogCaptureFixture
) -> None:
    expire(certificates, "car1")
    put(store, [1])
    with backend(certificates, broker):
        async with running(store, broker, tls_files(certificates, "car1")) as outbox:
            await until(lambda: "1 results wait in the store" in caplog.text)
            certify(certificates, "car1")
            await until(lambda: store.unpublished_count("car1") == 0)
            failed = outbox.counts.failure
            certify(certificates, "car1")  # and again, in good time: a new connection takes it up
            put(store, [2])
            await until(lambda: outbox.counts.failure > failed)
            await until(lambda: store.unpublished_count("car1") == 0)


async def test_a_certificate_of_another_vehicle_than_the_payload_is_an_alarm_and_costs_the_others_nothing(
    tmp_path: Path, store: ResultStore, broker: Mosquitto, certificates: Path, sqlite_url: str
) -> None:
    """The broker lets car1 write to its own topic; what it says there of car2 is the backend's to refuse."""
    engine = open_database(sqlite_url)
    own = shift_message(shift_record(shift_result(7, to_gear=4, vehicle="car1")))
    lie = shift_message(shift_record(shift_result(7, to_gear=4, vehicle="car2")))
    with worker(tmp_path, f"mqtts://127.0.0.1:{broker.port}", sqlite_url, *tls_words(certificates, "fleet-backend")):
        async with MqttConnector(
            BrokerAddress(host="127.0.0.1", port=broker.port, tls=tls_files(certificates, "car1")), "liar"
        ).connect(NOW) as link:
            await link.send([replace(lie, topic=own.topic)])
        await until(lambda: bool(queries.identity_alarms(engine)), ALARM_S)
        put(store, [7])  # put right: the same shift as what it is
        async with running(store, broker, tls_files(certificates, "car1")):
            await until(lambda: store.unpublished_count("car1") == 0)
    (alarm,) = queries.identity_alarms(engine)
    assert (alarm["vehicle"], alarm["message_count"]) == ("car1", 1)
    assert "car2" in str(alarm["reason"])
    assert [(row["vehicle"], row["seq"]) for row in queries.trend(engine, "car1", 2, TrendAxis.SHIFT)] == [("car1", 7)]
    assert queries.result_count(engine) == 1
    assert "identity: 1 messages put aside" in (tmp_path / "worker-0.log").read_text(encoding="utf-8")
    engine.dispose()
