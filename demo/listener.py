"""What a subscriber of MQTT hears of the service: shifts as they come, and the clutch states that the broker keeps."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass

import aiomqtt

from demo.errors import DemoError
from diag_service.diagnosis.records import FrictionEstimate, ShiftResult, shift_from, verdict_from
from diag_service.errors import ResultError
from fleet_contract import CLUTCHES, Channel, ContractError, Incoming, read_message, topic_of
from fleet_link import BrokerAddress

_AT_LEAST_ONCE = 1
_RETAINED_S = 5.0  # a broker sends what it keeps at once


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchState:
    """The retained state of one clutch."""

    clutch: int
    condition: str
    reason: str
    friction: FrictionEstimate | None  # running estimate, all shifts combined
    shift_count: int
    advice: str | None = None  # what the clutch says, how sure; None of older programs
    order: str | None = None  # what to do about the fluid of the vehicle; likewise


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
                    self._take(_read(message), is_retained=message.retain)
                    self._heard.notify_all()
        except aiomqtt.MqttError as exc:
            raise DemoError(f"the broker was lost: {exc}") from exc
        except (ContractError, ResultError) as exc:
            raise DemoError(f"the broker delivered what is not of this service: {exc}") from exc

    async def service_online(self) -> None:
        """Return when the service has announced itself."""
        async with self._heard:
            await self._heard.wait_for(lambda: self._is_online)

    async def shift_count(self, count: int) -> None:
        """Return when so many shifts have been heard."""
        async with self._heard:
            await self._heard.wait_for(lambda: len(self._shifts) >= count)

    def _take(self, message: Incoming, *, is_retained: bool) -> None:
        if message.address.channel is Channel.STATUS:
            # What a broker kept is of an earlier service: ours is announced while we listen.
            self._is_online = not is_retained and message.data["status"] == "online"
        elif message.address.channel is Channel.SHIFT:
            result = shift_from(message.data)
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
        for channel in (Channel.STATUS, Channel.SHIFT):
            await client.subscribe(topic_of(vehicle, channel), qos=_AT_LEAST_ONCE)
        yield Listener(client.messages, vehicle, on_shift)


async def read_clutch_states(address: BrokerAddress, vehicle: str) -> dict[int, ClutchState]:
    """Return the states that the broker keeps for those who come late; a clutch without one is left out.

    Raises
    ------
    DemoError
        If the broker cannot be reached.
    """
    states: dict[int, ClutchState] = {}
    clutch_of = {topic_of(vehicle, Channel.CLUTCH, clutch): clutch for clutch in CLUTCHES}
    async with _connected(address) as client:
        for topic in clutch_of:
            await client.subscribe(topic, qos=_AT_LEAST_ONCE)
        try:
            async with asyncio.timeout(_RETAINED_S):
                async for message in client.messages:
                    clutch = clutch_of.get(str(message.topic))  # a broker may repeat, or add what nobody asked for
                    if clutch is not None:
                        states[clutch] = _clutch_state(message)
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


def _clutch_state(message: aiomqtt.Message) -> ClutchState:
    try:
        data = _read(message).data
        verdict = verdict_from(data)
    except (ContractError, ResultError) as exc:
        raise DemoError(f"the broker keeps what is no clutch state: {exc}") from exc
    return ClutchState(
        clutch=verdict.clutch,
        condition=verdict.condition.name.lower().replace("_", " "),
        reason=verdict.reason,
        friction=verdict.friction,
        shift_count=verdict.shift_count,
        advice=verdict.advice,
        order=None if data.get("order") is None else str(data["order"]),
    )


def _read(message: aiomqtt.Message) -> Incoming:
    payload = message.payload if isinstance(message.payload, bytes) else str(message.payload).encode()
    return read_message(str(message.topic), payload)
