"""Opens the CAN bus that a user names, for both programs; knows CAN, and no clutch."""

from canbus.multicast import MulticastBus
from canbus.opening import UDP_MULTICAST, open_bus

__all__ = ["UDP_MULTICAST", "MulticastBus", "open_bus"]
