"""The least backend for tests: keeps the keys of results and, if it is told to, acknowledges them."""

import threading
from datetime import UTC, datetime
from typing import Self

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from fleet_contract import Channel, Receipt, ResultKey, ack_messages, filter_of, key_of, read_message
from tests.support.patience import HANG_S


class Acknowledger:
    """Hears results in a session that the broker keeps; ``keys`` says how often each came."""

    def __init__(self, port: int, *, is_acknowledging: bool = True, tls: tuple[str, str, str] | None = None) -> None:
        self.keys: dict[ResultKey, int] = {}
        self.is_acknowledging = is_acknowledging
        self._ready = threading.Event()
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, client_id="ingest-1", clean_session=False)
        self._client.reconnect_delay_set(min_delay=1, max_delay=1)
        if tls is not None:
            self._client.tls_set(*tls)  # authority, certificate, key
        self._client.on_connect = lambda client, *_: client.subscribe(filter_of(Channel.SHIFT), qos=1)
        self._client.on_subscribe = lambda *_: self._ready.set()
        self._client.on_message = self._take
        self._client.connect("127.0.0.1", port)

    def __enter__(self) -> Self:
        self._client.loop_start()
        assert self._ready.wait(HANG_S)
        return self

    def __exit__(self, *_: object) -> None:
        self._client.disconnect()
        self._client.loop_stop()

    def seqs(self) -> set[int]:
        """Return the numbers of the results that came."""
        return {key.seq for key in list(self.keys)}

    def _take(self, client: mqtt.Client, _userdata: object, message: mqtt.MQTTMessage) -> None:
        key = key_of(read_message(message.topic, bytes(message.payload)).data)
        self.keys[key] = self.keys.get(key, 0) + 1
        if self.is_acknowledging:
            now = datetime.now(UTC).replace(tzinfo=None).isoformat(timespec="microseconds") + "Z"
            for ack in ack_messages(key.vehicle, [Receipt(key=key)], sent_at=now, worker="ingest-1"):
                client.publish(ack.topic, ack.payload, qos=1)
