"""A port for a server that is told its own before it starts."""

import secrets
import socket
from typing import Final

# Below those that systems give to connections, any of which would take it before the server does.
PORTS: Final = range(20_000, 32_000)


def free_port() -> int:
    """Return a loopback port on which nobody listens now, neither for connections nor for datagrams."""
    while True:
        port = secrets.choice(PORTS)
        with socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp:
            try:
                tcp.bind(("127.0.0.1", port))
                udp.bind(("127.255.255.255", port))
            except OSError:
                continue
        return port
