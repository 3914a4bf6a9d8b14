"""Metrics of ingest, serve and watch as programs, and the alerts that Prometheus makes of them."""

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from urllib.error import URLError
from urllib.request import Request, urlopen

import pytest
from paho.mqtt import publish

from clutch_results.records import Condition
from fleet_backend.database import open_database
from fleet_backend.intake import MessageKind
from fleet_backend.rows import quarantine_row
from fleet_backend.writer import Batch, Writer
from tests.plugins.broker import Mosquitto
from tests.support.fleet import NOW, fleet_result, message_of, row_of
from tests.support.fleet_worker import worker
from tests.support.grafana import PROMETHEUS, yaml
from tests.support.patience import HANG_S
from tests.support.ports import free_port
from tests.support.prometheus import Samples, check_rules, parsed
from tests.tools import metrics_page

WORN = Condition.CHANGE_FLUID
RULES = PROMETHEUS / "fleet.rules.yml"
METRIC = re.compile(r"\bclutchdiag_\w+")
ALERTS = {rule["alert"]: rule for rule in yaml(RULES)["groups"][0]["rules"]}
OF_WORKERS = ("messages_total", "listening", "backlog_messages", "lag_seconds", "last_commit_timestamp_seconds")
OF_PAGES = ("vehicles", "clutches", "read_timestamp_seconds")
OF_FLEET = (
    "open_alarms",
    "quarantined_messages",
    "last_result_timestamp_seconds",
    "months_ahead",
    "last_partition_rows",
)
OF_WATCH = ("round_timestamp_seconds", "round_seconds", "waiting_vehicles", "undelivered_messages")
TOLD = {
    "ingest": {f"clutchdiag_ingest_{name}" for name in OF_WORKERS},
    "serve": {f"clutchdiag_fleet_{name}" for name in OF_PAGES},
    "watch": {f"clutchdiag_fleet_{name}" for name in (*OF_PAGES, *OF_FLEET)}
    | {f"clutchdiag_watch_{name}" for name in OF_WATCH},
}


def scraped(port: int, is_enough: Callable[[Mapping[str, float]], bool]) -> Samples:
    """Return what a program tells, once it is enough; the samples of one name are added up for that."""
    deadline_s = time.monotonic() + HANG_S
    while True:
        try:
            accepted = {"Accept": "application/openmetrics-text; version=1.0.0"}
            with urlopen(Request(f"http://127.0.0.1:{port}/metrics", headers=accepted)) as answer:
                found = parsed(answer.read().decode())
        except URLError:
            found = {}
        sums: dict[str, float] = {}
        for (name, labels), value in found.items():
            sums[name] = sums.get(name, 0.0) + value
            sums |= {f"{name} {text}": value for _, text in labels}
        if is_enough(sums):
            return found
        assert time.monotonic() < deadline_s, sums
        time.sleep(0.05)


@contextmanager
def program(*words: str) -> Iterator[int]:
    """Run a program of the backend, and yield the port of its metrics."""
    port = free_port()
    command = [sys.executable, "-m", "fleet_backend", *words, "--metrics", f"127.0.0.1:{port}"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        yield port
        process.send_signal(signal.SIGTERM)
    assert process.returncode == 0


@pytest.mark.broker
def test_a_worker_tells_what_it_stored_and_what_it_could_not_use(
    tmp_path: Path, broker: Mosquitto, postgres_url: str
) -> None:
    port = free_port()
    with worker(tmp_path, broker.url, postgres_url, "--metrics", f"127.0.0.1:{port}"):
        messages = [message_of(fleet_result(seq)) for seq in (1, 2, 3)]
        for one in messages:
            publish.single(one.topic, one.payload, 1, port=broker.port)
        publish.single("clutchdiag/v1/car1/shift", b"none", 1, port=broker.port)
        found = scraped(port, lambda sums: sums.get("clutchdiag_ingest_messages_total", 0.0) >= 4.0)
        counts = {kind.name.lower(): 0.0 for kind in MessageKind} | {"shift": 3.0, "poison": 1.0}
        for kind, count in counts.items():
            assert found["clutchdiag_ingest_messages_total", frozenset({("kind", kind)})] == count
        nothing = frozenset[tuple[str, str]]()
        assert found["clutchdiag_ingest_listening", nothing] == 1.0
        assert time.time() - HANG_S < found["clutchdiag_ingest_last_commit_timestamp_seconds", nothing] <= time.time()
        scraped(
            port,
            lambda sums: sums["clutchdiag_ingest_backlog_messages"] == sums["clutchdiag_ingest_lag_seconds"] == 0.0,
        )
        assert {name for name, _ in found} == TOLD["ingest"]
        broker.stop()
        scraped(port, lambda sums: sums["clutchdiag_ingest_listening"] == 0.0)


@pytest.mark.parametrize(
    "words", [("serve", "--listen", "127.0.0.1:0"), ("watch",), ("watch", "--listen", "127.0.0.1:0")]
)
def test_pages_and_watch_tell_how_large_the_fleet_is(postgres_url: str, words: tuple[str, ...]) -> None:
    engine = open_database(postgres_url)
    Writer(engine).store(
        Batch(shifts=[row_of(fleet_result(1, vehicle=str(one), condition=one)) for one in (Condition.GOOD, WORN)])
    )
    Writer(engine).store(
        Batch(quarantined=[quarantine_row(NOW, topic="t", vehicle="car1", payload=b"x", reason="schema", detail="")])
    )
    engine.dispose()
    with program(*words, "--database", postgres_url) as port:
        wanted = "clutchdiag_watch_round_timestamp_seconds" if words[0] == "watch" else "clutchdiag_fleet_vehicles"
        found = scraped(port, lambda sums: sums.get("clutchdiag_fleet_vehicles") == 2.0 and wanted in sums)
    for verdict in ("good", "change_fluid"):
        assert found["clutchdiag_fleet_clutches", frozenset({("verdict", verdict)})] == 1.0
    if words[0] == "watch":
        assert found["clutchdiag_fleet_months_ahead", frozenset()] == 3.0
        assert found["clutchdiag_fleet_open_alarms", frozenset({("rule", "verdict")})] == 1.0
    assert {name for name, _ in found} == TOLD[words[0]]


def test_the_page_lists_what_is_told_and_rules_ask_for_nothing_else() -> None:
    told = set().union(*TOLD.values())
    listed = set(re.findall(r"^\| `(clutchdiag_(?:ingest|fleet|watch)_\w+)`", metrics_page.page(), re.MULTILINE))
    assert listed == told
    asked = set(METRIC.findall(RULES.read_text(encoding="utf-8")))
    assert len(asked) > 10
    assert asked <= told


HEALTHY = {
    'up{job="fleet", instance="a"}': "1x120",
    'clutchdiag_ingest_listening{instance="a"}': "1x120",
    'clutchdiag_ingest_lag_seconds{instance="a"}': "0x120",
    'clutchdiag_ingest_backlog_messages{instance="a"}': "20x120",
    'clutchdiag_ingest_last_commit_timestamp_seconds{instance="a"}': "0+60x120",
    'clutchdiag_ingest_messages_total{instance="a", kind="poison"}': "0x120",
    'clutchdiag_ingest_messages_total{instance="a", kind="withheld"}': "0x120",
    'clutchdiag_fleet_quarantined_messages{instance="c", reason="schema"}': "5x120",
    'clutchdiag_fleet_open_alarms{instance="c", rule="verdict"}': "0x120",
    'clutchdiag_watch_round_timestamp_seconds{instance="c"}': "0+60x120",
    'clutchdiag_watch_undelivered_messages{instance="c"}': "0x120",
    'clutchdiag_fleet_months_ahead{instance="c"}': "3x120",
    'clutchdiag_fleet_last_partition_rows{instance="c"}': "0x120",
    'clutchdiag_fleet_vehicles{instance="c"}': "1000x120",
    'clutchdiag_fleet_read_timestamp_seconds{instance="c"}': "0+60x120",
}
TROUBLES = {  # what a series says instead from the start, and which alert that is
    "FleetProgramDown": ('up{job="fleet", instance="a"}', "0x120"),
    "IngestNotListening": ('clutchdiag_ingest_listening{instance="a"}', "0x120"),
    "IngestLags": ('clutchdiag_ingest_lag_seconds{instance="a"}', "0+60x120"),
    "IngestBehind": ('clutchdiag_ingest_backlog_messages{instance="a"}', "1000x120"),
    "IngestCommitsNothing": ('clutchdiag_ingest_last_commit_timestamp_seconds{instance="a"}', "-30000x120"),
    "FleetQuarantine": ('clutchdiag_ingest_messages_total{instance="a", kind="poison"}', "0+10x120"),
    "FleetIdentity": ('clutchdiag_fleet_quarantined_messages{instance="c", reason="identity"}', "1x120"),
    "FleetBeyondQuota": ('clutchdiag_ingest_messages_total{instance="a", kind="withheld"}', "0+1x120"),
    "FleetAlarm": ('clutchdiag_fleet_open_alarms{instance="c", rule="verdict"}', "1x120"),
    "WatchDead": ('clutchdiag_watch_round_timestamp_seconds{instance="c"}', "0x120"),
    "WatchDeliversNothing": ('clutchdiag_watch_undelivered_messages{instance="c"}', "2x120"),
    "FleetPartitionsEnd": ('clutchdiag_fleet_months_ahead{instance="c"}', "0x120"),
    "FleetShrinks": ('clutchdiag_fleet_vehicles{instance="c"}', "1000x40 800x79"),
    "FleetViewOld": ('clutchdiag_fleet_read_timestamp_seconds{instance="c"}', "0x120"),
}


def test_every_alert_fires_where_something_is_wrong_and_none_where_nothing_is(tmp_path: Path) -> None:
    assert TROUBLES.keys() == ALERTS.keys()
    groups = []
    for trouble in ("", *TROUBLES):
        instead = {TROUBLES[trouble][0]: TROUBLES[trouble][1]} if trouble else {}
        firing = [
            {"expr": f'count(ALERTS{{alertname="{name}", alertstate="firing"}}) or vector(0)', "eval_time": "110m"}
            | {"exp_samples": [{"labels": "{}", "value": int(name == trouble)}]}
            for name in ALERTS
        ]
        of = [{"series": series, "values": values} for series, values in (HEALTHY | instead).items()]
        groups.append({"name": trouble, "interval": "1m", "input_series": of, "promql_expr_test": firing})
    check_rules(tmp_path, groups, RULES)
