"""The least that an edge can be: sends messages until the backend acknowledges them, over any broker's death."""

import json
import threading
import time
from collections import Counter
from collections.abc import Sequence
from typing import Final, Self

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from fleet_contract import Outgoing
from tests.support.patience import HANG_S

RESEND_S: Final = 1.0  # first, then twice as long each time
_CONNECT_S: Final = 0.05
Key = tuple[str, str, int, str]  # vehicle, stream, seq, algorithm


class ResendingEdge:
    """Keeps every message until its receipt, and counts receipts by outcome."""

    def __init__(self, port: int, name: str = "edge") -> None:
        self.outcomes: Counter[str] = Counter()  # of different results
        self.sent_count = 0
        self._waiting: dict[Key, Outgoing] = {}
        self._changed = threading.Condition()
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, client_id=name, protocol=mqtt.MQTTv5)
        self._client.max_inflight_messages_set(1000)
        self._client.reconnect_delay_set(min_delay=1, max_delay=1)
        self._client.on_connect = lambda client, *_: client.subscribe("clutchdiag/v1/+/ack", qos=1)
        self._client.on_message = self._hear
        self._client.connect_async("127.0.0.1", port)

    def __enter__(self) -> Self:
        self._client.loop_start()
        return self

    def __exit__(self, *_: object) -> None:
        self._client.disconnect()
        self._client.loop_stop()

    @property
    def waiting_count(self) -> int:
        """Messages without a receipt."""
        with self._changed:
            return len(self._waiting)

    def keep(self, messages: Sequence[Outgoing]) -> None:
        """Take results to be delivered."""
        with self._changed:
            self._waiting |= {_key_of(message): message for message in messages}

    def deliver(self, timeout_s: float = HANG_S) -> None:
        """Send what is kept, again and again, until every receipt is here; fail the test if they never come."""
        deadline_s, pause_s = time.monotonic() + timeout_s, RESEND_S / 2.0
        while (count := self.waiting_count) > 0:
            assert time.monotonic() < deadline_s, f"{count} results without a receipt"
            pause_s = 2.0 * pause_s if self.send_once() else _CONNECT_S
            with self._changed:
                self._changed.wait_for(lambda: not self._waiting, pause_s)

    def send_once(self) -> bool:
        """Send what has no receipt, if a broker is there; return whether one was."""
        if not self._client.is_connected():
            return False
        with self._changed:
            waiting = list(self._waiting.values())
        for message in waiting:
            self._client.publish(message.topic, message.payload, qos=1)
        self.sent_count += len(waiting)
        return True

    def _hear(self, _client: mqtt.Client, _userdata: object, message: mqtt.MQTTMessage) -> None:
        data = json.loads(message.payload)["data"]
        with self._changed:
            for entry in data["results"]:
                key = (data["vehicle"], entry["stream"], entry["seq"], entry["algorithm_version"])
                if self._waiting.pop(key, None) is not None:
                    self.outcomes[entry["outcome"]] += 1
            self._changed.notify_all()


def _key_of(message: Outgoing) -> Key:
    data = json.loads(message.payload)["data"]
    return message.topic.split("/")[2], data["stream"], data["seq"], data["algorithm_version"]
