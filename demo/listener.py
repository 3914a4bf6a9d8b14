"""What a subscriber of MQTT hears of the service: shifts as they come, and the clutch states that the broker keeps."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, fields

import aiomqtt

from demo.errors import DemoError
from diag_service.errors import ResultError
from diag_service.publishers import BrokerAddress
from diag_service.publishers.mqtt import clutch_topic, shift_topic, status_topic
from diag_service.records import FrictionEstimate, ShiftResult
from diag_service.results import parse_shift

CLUTCHES = (1, 2)
_AT_LEAST_ONCE = 1
_RETAINED_S = 5.0  # a broker sends what it keeps at once
_FRICTION_KEYS = frozenset(field.name for field in fields(FrictionEstimate))


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchState:
    """The retained state of one clutch."""

    clutch: int
    condition: str
    reason: str
    friction: FrictionEstimate | None  # running estimate, all shifts combined
    shift_count: int


class Listener:
    """Hears one vehicle; a result that is delivered twice counts once."""

    def __init__(
        self, messages: AsyncIterator[aiomqtt.Message], vehicle: str, on_shift: Callable[[ShiftResult], None]
    ) -> None:
        self._messages = messages
        self._vehicle = vehicle
        self._on_shift = on_shift
        self._heard = asyncio.Condition()
        self._is_online = False
        self._shifts: dict[int, ShiftResult] = {}

    @property
    def shifts(self) -> tuple[ShiftResult, ...]:
        """The shifts heard until now, in the order of their numbers."""
        return tuple(self._shifts[seq] for seq in sorted(self._shifts))

    async def listen(self) -> None:
        """Hear until cancelled.

        Raises
        ------
        DemoError
            If the broker is lost, or delivers what the service did not send.
        """
        try:
            async for message in self._messages:
                async with self._heard:
                    self._take(str(message.topic), _text(message), is_retained=message.retain)
                    self._heard.notify_all()
        except aiomqtt.MqttError as exc:
            raise DemoError(f"the broker was lost: {exc}") from exc
        except (ResultError, ValueError, KeyError) as exc:
            raise DemoError(f"the broker delivered what is not of this service: {exc}") from exc

    async def service_online(self) -> None:
        """Return when the service has announced itself."""
        async with self._heard:
            await self._heard.wait_for(lambda: self._is_online)

    async def shift_count(self, count: int) -> None:
        """Return when so many shifts have been heard."""
        async with self._heard:
            await self._heard.wait_for(lambda: len(self._shifts) >= count)

    def _take(self, topic: str, text: str, *, is_retained: bool) -> None:
        if topic == status_topic(self._vehicle):
            # What a broker kept is of an earlier service: ours is announced while we listen.
            self._is_online = not is_retained and json.loads(text)["status"] == "online"
        elif topic == shift_topic(self._vehicle):
            result = parse_shift(text)
            if result.seq not in self._shifts:
                self._shifts[result.seq] = result
                self._on_shift(result)


@asynccontextmanager
async def listening(
    address: BrokerAddress, vehicle: str, on_shift: Callable[[ShiftResult], None]
) -> AsyncIterator[Listener]:
    """Subscribe to one vehicle; messages wait until ``listen`` is called.

    Raises
    ------
    DemoError
        If the broker cannot be reached.
    """
    async with _connected(address) as client:
        for topic in (status_topic(vehicle), shift_topic(vehicle)):
            await client.subscribe(topic, qos=_AT_LEAST_ONCE)
        yield Listener(client.messages, vehicle, on_shift)


async def read_clutch_states(address: BrokerAddress, vehicle: str) -> dict[int, ClutchState]:
    """Return the states that the broker keeps for those who come late; a clutch without one is left out.

    Raises
    ------
    DemoError
        If the broker cannot be reached.
    """
    states: dict[int, ClutchState] = {}
    clutch_of = {clutch_topic(vehicle, clutch): clutch for clutch in CLUTCHES}
    async with _connected(address) as client:
        for topic in clutch_of:
            await client.subscribe(topic, qos=_AT_LEAST_ONCE)
        try:
            async with asyncio.timeout(_RETAINED_S):
                async for message in client.messages:
                    clutch = clutch_of.get(str(message.topic))  # a broker may repeat, or add what nobody asked for
                    if clutch is not None:
                        states[clutch] = _clutch_state(_text(message))
                    if len(states) == len(clutch_of):
                        break
        except TimeoutError:
            return states
    return states


@asynccontextmanager
async def _connected(address: BrokerAddress) -> AsyncIterator[aiomqtt.Client]:
    client = aiomqtt.Client(address.host, address.port, username=address.username, password=address.password)
    try:
        async with client:
            yield client
    except aiomqtt.MqttError as exc:
        raise DemoError(f"broker {address}: {exc}") from exc


def _clutch_state(text: str) -> ClutchState:
    try:
        table = json.loads(text)
        friction = table["friction"]
        return ClutchState(
            clutch=table["clutch"],
            condition=table["condition"].replace("_", " "),
            reason=table["reason"],
            friction=None if friction is None else FrictionEstimate(**{key: friction[key] for key in _FRICTION_KEYS}),
            shift_count=table["shift_count"],
        )
    except (ValueError, KeyError, TypeError, AttributeError) as exc:
        raise DemoError(f"the broker keeps what is no clutch state: {text[:80]}") from exc


def _text(message: aiomqtt.Message) -> str:
    return message.payload.decode() if isinstance(message.payload, bytes) else str(message.payload)
