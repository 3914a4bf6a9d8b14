"""A subscriber for tests: hears what a backend would, over broker restarts."""

import threading
import time
from collections.abc import Callable
from typing import Any, Self

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from fleet_contract import read_message
from tests.support.patience import HANG_S

Payload = dict[str, Any]


class Session:
    """A client whose session the broker keeps; ``take`` gets each message."""

    def __init__(self, port: int, name: str, topic: str, take: Callable[[mqtt.MQTTMessage], None]) -> None:
        self._port, self._ready = port, threading.Event()
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, client_id=name, clean_session=False)
        self._client.reconnect_delay_set(min_delay=1, max_delay=1)
        self._client.on_connect = lambda client, *_: client.subscribe(topic, qos=1)
        self._client.on_subscribe = lambda *_: self._ready.set()
        self._client.on_message = lambda _client, _userdata, message: take(message)

    def __enter__(self) -> Self:
        self._client.connect("127.0.0.1", self._port)
        self._client.loop_start()
        assert self._ready.wait(HANG_S)
        return self

    def __exit__(self, *_: object) -> None:
        self._client.disconnect()
        self._client.loop_stop()


class Subscriber(Session):
    """Collects the data of every message under ``clutchdiag/v1``."""

    def __init__(self, port: int, username: str | None = None, password: str | None = None) -> None:
        super().__init__(port, "backend", "clutchdiag/v1/#", self._keep)
        self._client.username_pw_set(username, password)
        self._lock = threading.Lock()
        self._messages: list[tuple[str, Payload, bool]] = []

    def payloads(self, suffix: str) -> list[Payload]:
        """Return what came on the topics that end so, oldest first."""
        with self._lock:
            return [payload for topic, payload, _ in self._messages if topic.endswith(suffix)]

    def messages(self) -> list[tuple[str, Payload]]:
        """Return what came, by topic, oldest first."""
        with self._lock:
            return sorted(((topic, payload) for topic, payload, _ in self._messages), key=lambda heard: heard[0])

    def retained(self) -> dict[str, Payload]:
        """Return what the broker had kept when we subscribed."""
        with self._lock:
            return {topic: payload for topic, payload, is_retained in self._messages if is_retained}

    def wait(self, condition: Callable[["Subscriber"], bool], timeout_s: float = HANG_S) -> None:
        """Return when a condition holds; fail the test if it never does."""
        deadline_s = time.monotonic() + timeout_s
        while not condition(self):
            assert time.monotonic() < deadline_s, f"never came true; heard {self._outline()}"
            time.sleep(0.01)

    def _outline(self) -> list[tuple[str, object]]:
        with self._lock:
            return [(topic, payload.get("seq", payload.get("status"))) for topic, payload, _ in self._messages]

    def _keep(self, message: mqtt.MQTTMessage) -> None:
        data = read_message(message.topic, bytes(message.payload)).data
        with self._lock:
            self._messages.append((message.topic, data, message.retain))
