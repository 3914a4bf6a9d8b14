"""What systemd is told: that the service is ready, that it is alive, that it stops (sd_notify)."""

import logging
import os
import socket
from collections.abc import Mapping
from typing import Self

ADDRESS_VARIABLE = "NOTIFY_SOCKET"
WATCHDOG_VARIABLE = "WATCHDOG_USEC"
_LOG = logging.getLogger(__name__)


class ServiceManager:
    """The manager that started this process; without one, everything is told to nobody.

    Parameters
    ----------
    address : str or None
        Datagram socket of the manager; ``@`` begins an abstract one.
    watchdog_s : float or None
        How soon the manager wants to hear again before it takes the service for dead.
    """

    def __init__(self, address: str | None, watchdog_s: float | None) -> None:
        self._address = address
        self.watchdog_s = watchdog_s

    @classmethod
    def from_environment(cls, variables: Mapping[str, str] = os.environ) -> Self:
        """Return the manager that the environment names."""
        period_us = variables.get(WATCHDOG_VARIABLE, "")
        return cls(variables.get(ADDRESS_VARIABLE) or None, int(period_us) / 1e6 if period_us.isdecimal() else None)

    def ready(self) -> None:
        """Say that the bus is open."""
        self._tell("READY=1")

    def alive(self, status: str) -> None:
        """Say that the service is at work, and how it is, in a few words."""
        self._tell(f"WATCHDOG=1\nSTATUS={status}")

    def struggling(self, status: str) -> None:
        """Say how the service is without saying that it is alive: a watchdog that hears only this restarts it."""
        self._tell(f"STATUS={status}")

    def stopping(self) -> None:
        """Say that the end has begun."""
        self._tell("STOPPING=1")

    def _tell(self, text: str) -> None:
        if self._address is None:
            return
        address = f"\0{self._address[1:]}" if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as channel:
                channel.sendto(text.encode(), address)
        except OSError as exc:
            _LOG.debug("the service manager did not listen: %s", exc)
