"""The libraries of a tester, which the extra `uds` brings; without them, importing this says what to install."""

from canlog.extras import extra_missing

try:
    import isotp
    from udsoncan.client import Client
    from udsoncan.configs import default_client_config
    from udsoncan.connections import BaseConnection
    from udsoncan.exceptions import (
        InvalidResponseException,
        NegativeResponseException,
        TimeoutException,
        UnexpectedResponseException,
    )
    from udsoncan.Request import Request
except ImportError as exc:
    raise extra_missing("asking controllers needs udsoncan and can-isotp", "uds", "./workshop") from exc

__all__ = [
    "BaseConnection",
    "Client",
    "InvalidResponseException",
    "NegativeResponseException",
    "Request",
    "TimeoutException",
    "UnexpectedResponseException",
    "default_client_config",
    "isotp",
]
