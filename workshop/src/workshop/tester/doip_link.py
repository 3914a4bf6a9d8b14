"""A node of DoIP (ISO 13400-2) as doipclient has it, that keeps what comes late; needs the libraries of an extra."""

import logging
import time
from typing import Any, Final

from canlog.extras import load_extra

_client, _messages, _connectors = (
    load_extra(name, "DoIP needs doipclient", "uds", "./workshop")
    for name in ("doipclient", "doipclient.messages", "doipclient.connectors")
)
connector: Final = _connectors.DoIPClientUDSConnector
_PIECE_BYTES: Final = 65_536
_TCP: Final = _client.DoIPClient.TransportType.TRANSPORT_TCP
logging.getLogger("doipclient").setLevel(logging.CRITICAL + 1)  # it warns of every message for others


class DoipNode(_client.DoIPClient):  # type: ignore[misc, name-defined]  # a library without types
    """Waits as long as it is told; the library's own waits 2 s, and throws away what came after its time."""

    def read_doip(self, timeout: float = 2.0, transport: Any = _TCP) -> Any:  # noqa: ANN401 - messages without a common type
        """Return the next message; a part of one is kept. Raises OSError if none comes in time [s], or never will."""
        if transport != _TCP:
            return super().read_doip(timeout, transport)
        until_s, piece, usual_s = time.monotonic() + timeout, b"", self._tcp_sock.gettimeout()
        try:
            while True:
                message, piece = self._tcp_parser.read_message(bytearray(piece)), b""
                if isinstance(message, _messages.GenericDoIPNegativeAcknowledge):
                    raise ConnectionError(f"the node takes no such message: code {message.nack_code:02X}")
                if isinstance(message, _messages.AliveCheckRequest):
                    self.send_doip_message(_messages.AliveCheckResponse(self._client_logical_address))
                elif message is not None:
                    return message
                else:
                    left_s = until_s - time.monotonic()
                    if left_s <= 0.0:
                        raise TimeoutError("the node does not answer in time")
                    self._tcp_sock.settimeout(left_s)
                    piece = self._tcp_sock.recv(_PIECE_BYTES)
                    if not piece:
                        raise ConnectionResetError("the node has closed the connection")
        finally:
            self._tcp_sock.settimeout(usual_s)
