"""A serial port with an ELM327 adapter at one baud rate: characters at another one are not those that were sent."""

import os
import pty
import select
import socket
import termios
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

GARBAGE = b"\xf8\x80"  # what a receiver makes of characters at another rate
_RATE = 5  # of the attributes of a terminal, for output
_READ_BYTES = 4096
_POLL_S = 0.05


@contextmanager
def serial_adapter(server: tuple[str, int], rate: int) -> Iterator[str]:
    """Yield the name of a serial port behind which an adapter of the network speaks at ``rate`` (of `termios`).

    It sends a character of value 0 after each other, as the data sheet says that adapters may.
    """
    near, far = pty.openpty()
    over = threading.Event()
    with socket.create_connection(server) as adapter:

        def serve() -> None:
            while not over.is_set():
                for source in select.select([near, adapter.fileno()], [], [], _POLL_S)[0]:
                    is_understood = termios.tcgetattr(far)[_RATE] == rate
                    if source != near:
                        answer = b"".join(bytes([character, 0]) for character in adapter.recv(_READ_BYTES))
                        os.write(near, answer if is_understood else GARBAGE)
                    elif is_understood:
                        adapter.sendall(os.read(near, _READ_BYTES))
                    else:
                        os.read(near, _READ_BYTES)
                        os.write(near, GARBAGE)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield os.ttyname(far)
        finally:
            over.set()
            thread.join()
            for descriptor in (near, far):
                with suppress(OSError):
                    os.close(descriptor)
