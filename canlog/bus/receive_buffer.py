"""How much a socket keeps for a reader that is busy: the default of the system loses frames, and says nothing of it."""

import socket
from typing import Final

RECEIVE_BUFFER_BYTES: Final = 8 * 1024 * 1024  # about ten thousand frames: some seconds of a full bus
SO_RCVBUFFORCE: Final = 33  # linux/socket.h


def grow_receive_buffer(opened: socket.socket, size_bytes: int = RECEIVE_BUFFER_BYTES) -> None:
    """Set the receive buffer's size, past the system's limit if we may."""
    try:
        opened.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, size_bytes)
    except OSError:  # not ours to force, or another system
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size_bytes)
