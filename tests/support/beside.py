"""Work in a thread of its own while a test goes on."""

import threading
from abc import ABC, abstractmethod
from typing import Self


class Beside(ABC):
    """Does its work while it is entered, until it sees that this is over."""

    def __init__(self) -> None:
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._work, name=type(self).__name__, daemon=True)

    @abstractmethod
    def _work(self) -> None: ...

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._thread.join()
