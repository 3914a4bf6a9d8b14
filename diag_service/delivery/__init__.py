"""Those who hear of results: people, the next program in a pipe, a broker, and a double for tests."""

from diag_service.delivery.base import Link, Reporter
from diag_service.delivery.console import ConsoleReporter
from diag_service.delivery.delivery import Acknowledge
from diag_service.delivery.detached import DetachedReporter
from diag_service.delivery.jsonlines import JsonLinesReporter
from diag_service.delivery.limits import DeliveryLimits
from diag_service.delivery.memory import MemoryLink, MemoryReporter
from diag_service.delivery.mqtt import MqttConnector
from diag_service.delivery.outbox import Outbox

__all__ = [
    "Acknowledge",
    "ConsoleReporter",
    "DeliveryLimits",
    "DetachedReporter",
    "JsonLinesReporter",
    "Link",
    "MemoryLink",
    "MemoryReporter",
    "MqttConnector",
    "Outbox",
    "Reporter",
]
