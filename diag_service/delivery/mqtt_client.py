"""aiomqtt's client with what it lacks: many messages in flight at once, refusals told, no socket left behind."""

import asyncio
from collections import deque
from collections.abc import Sequence
from typing import Any, Final, Self

import aiomqtt
from paho.mqtt.client import MQTT_ERR_SUCCESS, MQTT_LOG_ERR, ConnectFlags
from paho.mqtt.client import Client as PahoClient
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from diag_service.errors import PublishError
from fleet_contract import Outgoing

AT_LEAST_ONCE: Final = 1
MAX_IN_FLIGHT: Final = 100  # unless the broker takes fewer
_UNLIMITED_IN_FLIGHT: Final = 65535  # MQTT 5.0, 3.2.2.3.3: without a Receive Maximum


class PipeliningClient(aiomqtt.Client):
    """Sends batches; a broker's refusal of a message is an error, which plain aiomqtt does not tell."""

    def __init__(self, *arguments: Any, **options: Any) -> None:  # noqa: ANN401 - signature of aiomqtt
        super().__init__(*arguments, **options, max_inflight_messages=MAX_IN_FLIGHT)
        self._window = 1
        self._in_flight: dict[int, str] = {}  # message id -> topic
        self._granted: set[str] = set()  # topics on which the broker took a message
        self._is_probing = False  # on a topic that is not among them
        self._answered = asyncio.Event()
        self.refusal: str | None = None  # of a message of the last batch
        self.complaint: str | None = None  # of the socket: TLS says no after the handshake, and plain aiomqtt times out
        self._client.on_log = self._note_complaint

    async def __aenter__(self) -> Self:
        try:
            return await super().__aenter__()
        except BaseException:
            self._client.disconnect()
            raise

    async def publish_all(self, messages: Sequence[Outgoing]) -> None:
        """Return when the broker has acknowledged all messages.

        Raises
        ------
        PublishError
            If it refuses one, or does not answer for as long as a call may take.
        MqttError
            If the connection is gone.
        """
        self.refusal = None
        self._in_flight.clear()  # what an interrupted call left behind
        queue = deque(messages)
        while queue or self._in_flight:
            while queue and self._may_start(queue[0].topic):
                self._start(queue.popleft())
            self._answered.clear()
            try:
                await asyncio.wait_for(self._answered.wait(), self.timeout)  # the next answer, not the last
            except TimeoutError:
                raise PublishError(f"no answer in {self.timeout:g} s") from None
            if self.refusal is not None:
                raise PublishError(self.refusal)

    def _may_start(self, topic: str) -> bool:
        """Return whether a message may go now: the first of a topic goes alone.

        Mosquitto 2.0.11 says no to a message and then drops the connection if more came with it; its answer is lost.
        """
        if not self._in_flight:
            return True
        return topic in self._granted and not self._is_probing and len(self._in_flight) < self._window

    def _start(self, message: Outgoing) -> None:
        info = self._client.publish(message.topic, message.payload, AT_LEAST_ONCE, message.is_retained)
        if info.rc != MQTT_ERR_SUCCESS:
            raise aiomqtt.MqttCodeError(info.rc, "cannot send")
        self._in_flight[info.mid] = message.topic
        self._is_probing = message.topic not in self._granted

    def _note_complaint(self, _client: PahoClient, _userdata: object, level: int, text: str) -> None:
        if level == MQTT_LOG_ERR:
            self.complaint = text

    def _on_connect(
        self,
        client: PahoClient,
        userdata: Any,  # noqa: ANN401 - signature of paho-mqtt
        flags: ConnectFlags,
        reason_code: ReasonCode,
        properties: Properties | None = None,
    ) -> None:
        limit = getattr(properties, "ReceiveMaximum", _UNLIMITED_IN_FLIGHT)
        self._window = min(limit, MAX_IN_FLIGHT)
        super()._on_connect(client, userdata, flags, reason_code, properties)

    def _on_publish(
        self,
        client: PahoClient,
        userdata: Any,  # noqa: ANN401 - signature of paho-mqtt
        mid: int,
        reason_code: ReasonCode,
        properties: Properties,
    ) -> None:
        topic = self._in_flight.pop(mid, None)
        if topic is not None and reason_code.is_failure:
            self.refusal = f"{topic} was refused: {reason_code}"
        elif topic is not None:
            self._granted.add(topic)
        self._answered.set()
        super()._on_publish(client, userdata, mid, reason_code, properties)
