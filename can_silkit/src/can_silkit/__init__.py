"""SIL Kit for programs that use python-can: ``can.Bus("CAN1", interface="silkit")``."""

from can_silkit.bus import SilKitBus

__all__ = ["SilKitBus"]
__version__ = "0.9.0"
