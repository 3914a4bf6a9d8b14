"""Those who hear of results: people, the next program in a pipe, a broker, and a double for tests."""

from diag_service.delivery.console import ConsoleReporter, standard_output_reporter
from diag_service.delivery.delivery import Acknowledge
from diag_service.delivery.mqtt import MqttConnector
from diag_service.delivery.outbox import Outbox
from diag_service.delivery.reporters import (
    AllReporters,
    ControllerNews,
    DeliveryLimits,
    DetachedReporter,
    JsonLinesReporter,
    Link,
    MemoryReporter,
    News,
    PipeReporter,
    Reporter,
)

__all__ = [
    "Acknowledge",
    "AllReporters",
    "ConsoleReporter",
    "ControllerNews",
    "DeliveryLimits",
    "DetachedReporter",
    "JsonLinesReporter",
    "Link",
    "MemoryReporter",
    "MqttConnector",
    "News",
    "Outbox",
    "PipeReporter",
    "Reporter",
    "standard_output_reporter",
]
