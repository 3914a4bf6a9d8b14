"""The bus that a user names: which it is, by command line, environment and can.conf, and how it is opened."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import can

from canlog.errors import SourceError
from canlog.live.socketcan import SOCKETCAN, SocketCanSource, named_channel, restart_controller
from canlog.live.sources import FrameSource, ReadSchedule

if TYPE_CHECKING:
    from canlog.live.pythoncan import PythonCanSource


@dataclass(frozen=True, slots=True, kw_only=True)
class BusSettings:
    """A bus, fully named."""

    interface: str
    channel: str | None
    bitrate: int | None
    fd: bool

    @property
    def description(self) -> str:
        """Interface and channel, for people."""
        return f"{self.interface} {self.channel}" if self.channel is not None else self.interface


class BusOpener:
    """Opens one bus, again and again.

    Interface, channel, bit rate and ``fd`` are as python-can names them; what is not given comes from
    ``CAN_INTERFACE``, ``CAN_CHANNEL`` and ``CAN_BITRATE``, then from ``can.conf``. Filters, identifiers with masks, and
    schedule are for SocketCAN; other interfaces give everything at once. A bus with a time of its own, as a simulation
    has, is left after ``duration_s`` of that time; ``counts_duration`` tells whether this one is.
    """

    def __init__(
        self,
        interface: str | None = None,
        channel: str | None = None,
        bitrate: int | None = None,
        *,
        fd: bool = False,
        filters: Sequence[tuple[int, int]] = (),
        schedule: ReadSchedule | None = None,
        duration_s: float | None = None,
    ) -> None:
        self._schedule = schedule
        self._left_s = duration_s
        self._timed: PythonCanSource | None = None  # the last bus that had a time of its own
        self._given = (interface, channel, bitrate, fd)
        self._filters = filters
        self._settings: BusSettings | None = None

    @property
    def counts_duration(self) -> bool:
        """Whether the bus that was opened has a time of its own, in which the duration counts."""
        return self._timed is not None

    async def open(self) -> FrameSource:
        """Open the bus; when this returns, it receives.

        Raises
        ------
        SourceError
            If the bus is not named completely or cannot be opened.
        """
        if self._settings is None:
            # A driver may take a second to be found and to open: that must not stop the loop.
            interface, channel, bitrate, fd = self._given
            self._settings = await asyncio.to_thread(complete_settings, interface, channel, bitrate, fd=fd)
        settings = self._settings
        if settings.interface != SOCKETCAN:
            from canlog.live import pythoncan  # noqa: PLC0415 - heavy, and not needed for SocketCAN

            bus = await asyncio.to_thread(
                pythoncan.open_bus, settings.interface, settings.channel, settings.bitrate, fd=settings.fd
            )
            if self._timed is not None and self._left_s is not None:
                self._left_s = max(0.0, self._left_s - self._timed.time_s)
            source = pythoncan.PythonCanSource(bus, settings.description, duration_s=self._left_s)
            self._timed = source if source.has_own_time else None
            return source
        return SocketCanSource(
            named_channel(settings.channel), fd=settings.fd, filters=self._filters, schedule=self._schedule
        )

    async def restart(self) -> str | None:
        """Ask the controller to leave bus-off; return why that cannot be, None if it was accepted."""
        settings = self._settings
        if settings is None or settings.interface != SOCKETCAN or settings.channel is None:
            return "only SocketCAN offers it"
        return await asyncio.to_thread(restart_controller, settings.channel)


def complete_settings(interface: str | None, channel: str | None, bitrate: int | None, *, fd: bool) -> BusSettings:
    """Return the settings with what the user left out taken from environment and configuration files.

    Raises SourceError if no interface is named anywhere, or one that python-can does not know.
    """
    if interface == SOCKETCAN and channel is not None:
        return BusSettings(interface=interface, channel=channel, bitrate=bitrate, fd=fd)
    given = {"interface": interface, "channel": channel, "bitrate": bitrate}
    try:
        config = can.util.load_config(config={key: value for key, value in given.items() if value is not None})
    except can.CanInterfaceNotImplementedError as exc:
        hint = "-i INTERFACE -c CHANNEL, CAN_INTERFACE and CAN_CHANNEL, or ~/can.conf"
        if interface is None:
            raise SourceError(f"no usable CAN interface given: use {hint} ({exc})") from exc
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise SourceError(f"unknown CAN interface {interface!r}: choose one of {known}") from exc
    except (OSError, ValueError, TypeError) as exc:
        raise SourceError(f"the configuration of python-can cannot be used: {exc}") from exc
    name, rate = config.get("channel"), config.get("bitrate")
    return BusSettings(
        interface=str(config["interface"]),
        channel=None if name is None else str(name),
        bitrate=None if rate is None else int(rate),
        fd=fd or bool(config.get("fd")),
    )
