"""Processor time of a User-Mode Linux guest as its host counts it.

A guest does not know when its host ran something else: it takes that time for work of its own. The host knows. The
two share their files: the guest asks by making one, the host answers in another.
"""

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

import psutil

FOLDER_VARIABLE: Final = "CLUTCHDIAG_BENCHMARK_METER"
KERNEL: Final = "linux.uml"
POLL_S: Final = 0.01


def meter_folder() -> Path | None:
    """Return where to ask, None where nobody answers."""
    folder = os.environ.get(FOLDER_VARIABLE)
    return None if folder is None else Path(folder)


def ask(folder: Path) -> float:
    """Return the processor time that the whole guest has used until now [s]."""
    number = len(list(folder.glob("ask-*")))
    (folder / f"ask-{number}").touch()
    answer = folder / f"answer-{number}"
    while not answer.exists():
        time.sleep(POLL_S)
    return float(answer.read_text(encoding="ascii"))


@contextmanager
def answering(folder: Path) -> Iterator[None]:
    """Answer a guest that a descendant of this process runs, while entered."""
    is_over = threading.Event()

    def answer() -> None:
        while not is_over.wait(POLL_S):
            for question in folder.glob("ask-*"):
                reply = folder / question.name.replace("ask", "answer")
                if not reply.exists():
                    draft = folder / f"draft-{question.name}"
                    draft.write_text(repr(used_s()), encoding="ascii")
                    draft.rename(reply)

    thread = threading.Thread(target=answer, name="guest meter")
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def used_s() -> float:
    """Return the processor time of all kernels of guests below this process, and of what runs in them [s]."""
    total_s = 0.0
    for process in psutil.Process().children(recursive=True):
        with suppress(psutil.NoSuchProcess):
            if KERNEL in process.name():
                total_s += sum(process.cpu_times()[:4])  # own and those of processes that ended, user and system
    return total_s
