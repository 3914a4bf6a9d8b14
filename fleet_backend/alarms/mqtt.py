"""Alarms by MQTT: an event on its vehicle's topic, for programs that subscribe to one vehicle or to all."""

import asyncio
import json
from dataclasses import dataclass
from datetime import datetime
from typing import Final

from fleet_backend.alarms.book import Letter
from fleet_backend.errors import CarrierError
from fleet_contract import Outgoing
from fleet_link import BrokerAddress, Connection, LinkError, Terms

TOPIC_ROOT: Final = "clutchdiag/alarms/v1"  # of its own: who collects results does not get alarms among them
_SOURCE: Final = "fleet-backend"


@dataclass(frozen=True, slots=True, kw_only=True)
class Mqtt:
    """Publishes to a broker, and has delivered when the broker acknowledged."""

    broker: BrokerAddress
    name: str = "mqtt"

    def deliver(self, letter: Letter, now: datetime) -> None:  # noqa: ARG002 - as carriers are asked
        """Publish a message; raises CarrierError unless the broker takes it."""
        try:
            asyncio.run(self._publish(message_of(letter)))
        except (LinkError, OSError) as exc:
            raise CarrierError(f"mqtt: {exc}") from exc

    async def _publish(self, message: Outgoing) -> None:
        connection = await Connection.open(self.broker, Terms(is_key_private=False))
        try:
            await connection.publish_all([message])
        finally:
            await connection.close()


def message_of(letter: Letter) -> Outgoing:
    """Return the message of an alarm: a CloudEvents event whose id is the key, not retained.

    A broker keeps one message of a topic: it would say one alarm of a vehicle again to everybody, and no other.
    """
    told = letter.payload
    event = {
        "specversion": "1.0",
        "id": letter.key,
        "source": _SOURCE,
        "type": f"clutchdiag.alarm.{told['event']}",
        "subject": told["alarm"],
        "time": told["at"],
        "datacontenttype": "application/json",
        "data": dict(told),
    }
    topic = f"{TOPIC_ROOT}/{told['vehicle']}"
    return Outgoing(topic=topic, payload=json.dumps(event).encode(), is_retained=False)
