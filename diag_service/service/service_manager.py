"""What systemd is told: that the service is ready, that it is alive, that it stops (sd_notify)."""

import logging
import socket

ADDRESS_VARIABLE = "NOTIFY_SOCKET"
_LOG = logging.getLogger(__name__)


class ServiceManager:
    """The manager that started this process; without one, everything is told to nobody.

    ``address`` is its datagram socket, as the environment names it; ``@`` begins an abstract one.
    """

    def __init__(self, address: str | None) -> None:
        self._address = address

    def ready(self) -> None:
        """Say that the bus is open."""
        self._notify("READY=1")

    def alive(self, status: str) -> None:
        """Say that the service is at work, and how it is, in a few words."""
        self._notify(f"WATCHDOG=1\nSTATUS={status}")

    def struggling(self, status: str) -> None:
        """Say how the service is without saying that it is alive: a watchdog that hears only this restarts it."""
        self._notify(f"STATUS={status}")

    def stopping(self) -> None:
        """Say that the end has begun."""
        self._notify("STOPPING=1")

    def _notify(self, text: str) -> None:
        if not self._address:
            return
        address = f"\0{self._address[1:]}" if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as channel:
                channel.sendto(text.encode(), address)
        except OSError as exc:
            _LOG.debug("the service manager could not be told: %s", exc)
