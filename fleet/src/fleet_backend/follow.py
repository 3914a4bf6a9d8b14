"""What vehicles tell, as it arrives: a line, or an object of JSON, for each result and each sign of life."""

import asyncio
import logging
import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import aiomqtt

from clutchdiag_io.people import PLUS_MINUS, plus_minus
from fleet_backend.choices import BROKER_VARIABLE
from fleet_backend.config import parse_broker
from fleet_backend.errors import BackendConfigError, BrokerError
from fleet_backend.ingest import Pauses
from fleet_backend.programs import until_stopped
from fleet_contract import (
    NEVER,
    TOPIC_ROOT,
    Channel,
    ContractError,
    Incoming,
    JsonObject,
    bundled_events,
    dump,
    is_vehicle,
    parse_topic,
    read_event,
)
from fleet_link import BrokerAddress

FOLLOWED: Final = (Channel.SHIFT, Channel.BUNDLE, Channel.STATUS)
_LOG: Final = logging.getLogger(__name__)


def follow(
    *, broker: str, vehicles: Sequence[str], ca: Path | None, cert: Path | None, key: Path | None, is_json: bool
) -> None:
    """Follow a broker until SIGINT or SIGTERM; raises ConfigError, and BrokerError if it cannot be reached at first."""
    url = os.environ.get(BROKER_VARIABLE, "") if broker == "-" else broker
    if not url:
        raise BackendConfigError(f"no broker: name one, or set {BROKER_VARIABLE}")
    address = parse_broker(url, ca=ca, certificate=cert, key=key)
    if strangers := [name for name in vehicles if not is_vehicle(name)]:
        raise BackendConfigError(f"{strangers[0]!r} is not a vehicle id")
    follower = Follower(address, vehicles, is_json=is_json)
    try:
        asyncio.run(until_stopped(follower.run()))
    finally:
        for reason, count in follower.left_out.items():
            _LOG.warning("%d message(s) left out: %s", count, reason)


class Follower:
    """Shows what vehicles say, all if none is named; a broker that goes away is asked again until it is back."""

    def __init__(self, address: BrokerAddress, vehicles: Sequence[str], *, is_json: bool) -> None:
        self.left_out: Counter[str] = Counter()  # by the rule of the contract that a message breaks
        self._address = address
        self._filters = [f"{TOPIC_ROOT}/{name}/{channel.label}" for name in vehicles or ("+",) for channel in FOLLOWED]
        self._is_json = is_json

    async def run(self) -> None:
        """Follow for ever; raises BrokerError if the first connection fails."""
        pauses, was_there = Pauses(), False
        while True:
            try:
                async with self._client() as client:
                    for name in self._filters:
                        codes = await client.subscribe(name, qos=0)
                        if any(getattr(code, "is_failure", False) for code in codes):
                            raise BrokerError(f"broker {self._address} refuses {name}")
                    pauses.reset()
                    was_there = True
                    async for message in client.messages:
                        self._show(str(message.topic), bytes(message.payload))
            except aiomqtt.MqttError as exc:
                lost = BrokerError(f"broker {self._address}: {exc}")
                if not was_there:
                    raise lost from exc
                await pauses.wait(lost)

    def _client(self) -> aiomqtt.Client:
        address, tls = self._address, self._address.tls
        return aiomqtt.Client(
            address.host,
            address.port,
            username=address.username,
            password=address.password,
            protocol=aiomqtt.ProtocolVersion.V311,  # which every broker speaks; nothing of a later one is used
            tls_context=None if tls is None else tls.context(is_key_private=False),
            logger=logging.getLogger("mqtt"),
        )

    def _show(self, topic: str, payload: bytes) -> None:
        try:
            for event in _events(topic, payload):
                text = dump(event.data) if self._is_json else line_of(event)
                sys.stdout.write(text + "\n")
        except ContractError as exc:
            self.left_out[exc.reason] += 1
            _LOG.warning("left out: %s", exc)
        sys.stdout.flush()


def _events(topic: str, payload: bytes) -> Iterator[Incoming]:
    """Yield what a message says; a bundle says several things. Raises ContractError."""
    address = parse_topic(topic)
    if address.channel is not Channel.BUNDLE:
        yield read_event(address, payload)
        return
    for event in bundled_events(payload):
        yield read_event(replace(address, channel=Channel.SHIFT), event)


def line_of(event: Incoming) -> str:
    data, vehicle = event.data, event.address.vehicle
    if event.address.channel is Channel.STATUS and data["connected_at"] == NEVER:
        return f"{event.time} {vehicle}: results of logs"
    if event.address.channel is Channel.STATUS:
        return f"{event.time} {vehicle}: {data['status']}"
    verdict = data["verdict"]
    advice = verdict.get("advice") if isinstance(verdict, dict) else None
    clutch = data.get("element") or f"clutch {data['clutch']}"
    gears = f"{data['from_gear']}-{data['to_gear']}"
    head = f"{event.time} {vehicle}: {clutch}, {data.get('kind', 'shift')} {gears}"
    return " ".join([f"{head}: {_finding(data)}.", str(advice or "")]).rstrip()


def _finding(data: JsonObject) -> str:
    friction = data["friction"]
    if not isinstance(friction, dict):
        reasons = data["reasons"]
        return f"not used ({', '.join(map(str, reasons)) if isinstance(reasons, list) else reasons})"
    mu_c, mu_s, std_c, std_s = (float(str(friction[name])) for name in ("mu_c", "mu_s", "std_mu_c", "std_mu_s"))
    return f"mu_C {plus_minus(mu_c, std_c)}, mu_S {plus_minus(mu_s, std_s)} ({PLUS_MINUS})"
