"""Opens the bus that a user names; one of multicast UDP keeps to this machine unless told otherwise."""

from canlog.bus.multicast import MulticastBus
from canlog.bus.opening import UDP_MULTICAST, open_bus

__all__ = ["UDP_MULTICAST", "MulticastBus", "open_bus"]
