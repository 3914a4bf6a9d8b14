"""Those who hear of results: people, the next program in a pipe, a broker, and a double for tests."""

from diag_service.publishers.base import Link, Reporter
from diag_service.publishers.console import ConsoleReporter
from diag_service.publishers.delivery import Acknowledge
from diag_service.publishers.detached import DetachedReporter
from diag_service.publishers.jsonlines import JsonLinesReporter
from diag_service.publishers.memory import MemoryLink, MemoryReporter
from diag_service.publishers.mqtt import BrokerAddress, MqttConnector
from diag_service.publishers.outbox import Outbox
from diag_service.publishers.tls import TlsFiles

__all__ = [
    "Acknowledge",
    "BrokerAddress",
    "ConsoleReporter",
    "DetachedReporter",
    "JsonLinesReporter",
    "Link",
    "MemoryLink",
    "MemoryReporter",
    "MqttConnector",
    "Outbox",
    "Reporter",
    "TlsFiles",
]
