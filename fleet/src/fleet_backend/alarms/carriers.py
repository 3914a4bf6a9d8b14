"""What brings alarms to people: apprise, which knows mail, chats, webhooks and MQTT. Each message ends with its key."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from apprise import Apprise, AppriseAsset, NotifyFormat, NotifyType

from fleet_backend.alarms.book import Letter
from fleet_backend.alarms.rules import Event
from fleet_backend.errors import CarrierError, ConfigError
from fleet_contract.orders import name_of
from fleet_link import AddressError, read_secret

_LONGEST_WAIT_S: Final = 15.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AppriseCarrier:
    """Hands messages to one address of apprise."""

    name: str
    apprise: Apprise = field(repr=False)

    def deliver(self, letter: Letter) -> None:
        """Deliver a message; raises CarrierError if it was not taken."""
        told, is_over = letter.payload, letter.payload["event"] == Event.CLEARED
        whose = told["vehicle"] + (f", {name_of(told['clutch'], told['element'])}" if told["clutch"] else "")
        is_taken = self.apprise.notify(
            title=f"{'Alarm over' if is_over else 'Alarm'}: {whose}: {told['rule']}",
            body=f"{told['reason']}\n\n{told['at']}\n{letter.key}",
            body_format=NotifyFormat.TEXT,
            notify_type=NotifyType.SUCCESS if is_over else NotifyType.WARNING,
        )
        if not is_taken:
            raise CarrierError(f"{self.name}: not delivered")  # apprise has logged why


def read_carrier(path: Path) -> AppriseCarrier:
    """Return the carrier whose address is in a file, called like the file.

    Raises ConfigError, without the address: it may hold a secret.
    """
    try:
        address = read_secret(path)
    except AddressError as exc:
        raise ConfigError(str(exc)) from exc
    apprise = Apprise(asset=AppriseAsset(http_redirects=False, service_timeout=_LONGEST_WAIT_S))
    if not apprise.add(address) or len(apprise) != 1:
        raise ConfigError(f"{path} must hold one address that apprise knows")
    return AppriseCarrier(name=path.stem, apprise=apprise)
