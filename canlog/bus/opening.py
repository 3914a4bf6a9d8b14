"""The bus that a user names: python-can's, but multicast UDP that keeps to this machine unless told otherwise."""

from collections.abc import Mapping
from typing import Any, Final

import can

from canlog.bus.multicast import DEFAULT_GROUP, MulticastBus

UDP_MULTICAST: Final = "udp_multicast"
_HANDLED: Final = frozenset({"interface", "channel"})


def open_bus(interface: str | None, channel: str | None, bitrate: int | None, *, fd: bool = False) -> can.BusABC:
    """Open a bus; what is not given comes from CAN_INTERFACE, CAN_CHANNEL, CAN_CONFIG and can.conf.

    The interface ``udp_multicast`` keeps to this machine unless the configuration names a ``hop_limit``. No bus hears
    itself, whatever is configured.

    Raises
    ------
    can.CanError, OSError, ValueError, TypeError, ImportError, RuntimeError
        If no bus is named, or it cannot be opened.
    """
    can.set_logging_level("critical")  # python-can logs what it raises, and more when a half-made bus goes
    options: dict[str, Any] = {"fd": True} if fd else {}  # what is not asked for is left to the driver
    if bitrate is not None:
        options["bitrate"] = bitrate
    named = {"interface": interface, "channel": channel}
    found = can.util.load_config(config={**{key: name for key, name in named.items() if name}, **options})
    if found["interface"] == UDP_MULTICAST:
        return _multicast(found)
    if found.get("receive_own_messages"):
        options["receive_own_messages"] = False
    return can.Bus(channel, interface, **options)


def _multicast(found: Mapping[str, Any]) -> MulticastBus:
    group = str(found.get("channel") or DEFAULT_GROUP)
    options = {key: value for key, value in found.items() if key not in _HANDLED}
    if type(options.get("hop_limit", 0)) is not int:  # nor a bool, which is an int
        raise TypeError(f"hop_limit must be a whole number, got {options['hop_limit']!r}")
    return MulticastBus(group, **options)
