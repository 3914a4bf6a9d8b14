"""What brings alarms to people: a webhook, signed as Standard Webhooks has it, e-mail, MQTT; each tells the key."""

import asyncio
import base64
import hashlib
import hmac
import json
import smtplib
import ssl
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from email.message import EmailMessage
from http import HTTPStatus
from http.client import HTTPException
from typing import Final, Protocol
from urllib.parse import SplitResult, unquote
from urllib.request import HTTPRedirectHandler, ProxyHandler, Request, build_opener

from fleet_backend.alarms.book import Letter
from fleet_backend.errors import CarrierError
from fleet_contract import Outgoing
from fleet_contract.orders import name_of
from fleet_link import BrokerAddress, Connection, LinkError, Terms

LONGEST_WAIT_S: Final = 15.0
_SMTP_PORTS: Final = {"smtp": 25, "smtps": 465}


class Carrier(Protocol):
    """Brings one message where it belongs."""

    @property
    def name(self) -> str:
        """What it is called in the book."""

    def deliver(self, letter: Letter, now: datetime) -> None:
        """Deliver a message; raises CarrierError if that did not work now."""


class NoRedirects(HTTPRedirectHandler):
    """An alarm or a secret goes where it was sent, nowhere else."""

    def redirect_request(self, *_: object) -> None:
        """Follow none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Webhook:
    """Posts to a server that can tell by the signature that it is us."""

    url: str
    secret: bytes = field(repr=False)
    name: str = "webhook"

    def deliver(self, letter: Letter, now: datetime) -> None:
        """Post a message; raises CarrierError unless the answer is a status from 200 to 299."""
        body = json.dumps({"type": f"clutchdiag.alarm.{letter.payload['event']}", "data": letter.payload}).encode()
        moment = str(int(now.timestamp()))
        headers = {
            "content-type": "application/json",
            "webhook-id": letter.key,
            "webhook-timestamp": moment,
            "webhook-signature": signature(self.secret, letter.key, moment, body),
        }
        opener = build_opener(NoRedirects, ProxyHandler({}))
        try:
            with opener.open(Request(self.url, body, headers), timeout=LONGEST_WAIT_S) as answer:  # noqa: S310 - checked
                status = int(answer.status)
        except (OSError, ValueError, HTTPException) as exc:
            raise CarrierError(f"webhook: {exc}") from exc
        if not HTTPStatus.OK <= status < HTTPStatus.MULTIPLE_CHOICES:
            raise CarrierError(f"webhook: status {status}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Mail:
    """Sends e-mail by a server for outgoing mail."""

    server: SplitResult = field(repr=False)  # smtp[s]://[user[:password]@]host[:port]
    sender: str
    recipients: tuple[str, ...]
    name: str = "mail"

    def deliver(self, letter: Letter, now: datetime) -> None:
        """Send a message; raises CarrierError if the server does not take it for all recipients."""
        try:
            with self._connect() as server:
                if self.server.username:
                    server.login(unquote(self.server.username), unquote(self.server.password or ""))
                refused = server.send_message(self._message(letter, now))
        except UnicodeEncodeError as exc:  # whose text would tell of the password
            raise CarrierError("mail: user, password and addresses must be ASCII") from exc
        except (smtplib.SMTPException, OSError, ValueError) as exc:
            raise CarrierError(f"mail: {exc}") from exc
        if refused:
            raise CarrierError(f"mail: refused for {', '.join(refused)}")

    def _connect(self) -> smtplib.SMTP:
        host, port = self.server.hostname or "", self.server.port or _SMTP_PORTS[self.server.scheme]
        if self.server.scheme == "smtps":
            made: smtplib.SMTP = smtplib.SMTP_SSL(
                host, port, timeout=LONGEST_WAIT_S, context=ssl.create_default_context()
            )
        else:
            made = smtplib.SMTP(host, port, timeout=LONGEST_WAIT_S)
            made.ehlo()
            if made.has_extn("starttls"):
                made.starttls(context=ssl.create_default_context())
        return made

    def _message(self, letter: Letter, now: datetime) -> EmailMessage:
        told = letter.payload
        message = EmailMessage()
        whose = told["vehicle"] + (f", {name_of(told['clutch'], told.get('element'))}" if told["clutch"] else "")
        state = "Alarm" if told["event"] == "raised" else "Alarm over"
        message["Subject"] = f"{state}: {whose}: {told['rule']}"
        message["From"], message["To"] = self.sender, ", ".join(self.recipients)
        message["Date"] = now
        digest = hashlib.sha256(letter.key.encode()).hexdigest()[:32]
        message["Message-ID"] = f"<{digest}@{self.sender.rpartition('@')[2]}>"  # the same at every attempt
        message.set_content(f"{whose}\n{told['reason']}\n\nsince {told['at']}\nalarm {told['alarm']}\n")
        return message


def signature(secret: bytes, key: str, moment: str, body: bytes) -> str:
    """Return the signature of a webhook's message, as Standard Webhooks has it."""
    signed = hmac.new(secret, f"{key}.{moment}.".encode() + body, hashlib.sha256).digest()
    return f"v1,{base64.b64encode(signed).decode()}"


def deliver_all(
    take: Callable[[str], Letter | None],
    settle: Callable[[Letter, str | None], None],
    carrier: Carrier,
    now: datetime,
    turn_s: float = LONGEST_WAIT_S,
) -> int:
    """Deliver what waits for a carrier until nothing does, or its turn ends; return how many messages arrived.

    A message that was delivered and not settled, because the process died between both, is delivered again under the
    same key.
    """
    count, end_s = 0, time.monotonic() + turn_s
    while (letter := take(carrier.name)) is not None:
        try:
            carrier.deliver(letter, now)
        except CarrierError as exc:
            settle(letter, str(exc))
        else:
            settle(letter, None)
            count += 1
        if time.monotonic() >= end_s:
            break
    return count


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
