"""The least backend for tests: keeps the keys of results and, if it is told to, acknowledges them."""

from datetime import UTC, datetime

import paho.mqtt.client as mqtt

from fleet_contract import Channel, Receipt, ResultKey, ack_messages, filter_of, key_of, read_message
from tests.support.subscriber import Session


class Acknowledger(Session):
    """Hears results; ``keys`` says how often each came."""

    def __init__(self, port: int, *, is_acknowledging: bool = True, tls: tuple[str, str, str] | None = None) -> None:
        super().__init__(port, "ingest-1", filter_of(Channel.SHIFT), self._count)
        self.keys: dict[ResultKey, int] = {}
        self.is_acknowledging = is_acknowledging
        if tls is not None:
            self._client.tls_set(*tls)  # authority, certificate, key

    def seqs(self) -> set[int]:
        """Return the numbers of the results that came."""
        return {key.seq for key in list(self.keys)}

    def _count(self, message: mqtt.MQTTMessage) -> None:
        key = key_of(read_message(message.topic, bytes(message.payload)).data)
        self.keys[key] = self.keys.get(key, 0) + 1
        if self.is_acknowledging:
            now = datetime.now(UTC).replace(tzinfo=None).isoformat(timespec="microseconds") + "Z"
            for ack in ack_messages(key.vehicle, [Receipt(key=key)], sent_at=now, worker="ingest-1"):
                self._client.publish(ack.topic, ack.payload, qos=1)
