"""The first drive of a car: recorded while it is asked, then diagnosed by commands that a person could type."""

import shlex
import time
from heapq import heappop, heappush
from itertools import count
from pathlib import Path
from typing import Final

import can

from canlog.errors import OutputError, SourceError
from clutchdiag_io.program import replacement_refusal
from diag_service.cli import command_line
from diag_service.commands.options import PROGRAM
from diag_service.errors import ConfigError
from diag_service.settings.config import BusConfig
from diag_service.stopping import Controls
from workshop.tester.asking import opened_bus
from workshop.tester.interview import Show
from workshop.tester.signal_asking import SignalAsker
from workshop.tester.transmissions import Transmission, description_path

PROGRESS_S: Final = 60.0  # from line to line while a drive is recorded
LOOK_S: Final = 0.1
HELD_S: Final = 0.5  # frames of several senders come out of order by less
LOGS: Final = (".log", ".asc", ".blf")  # python-can writes them, and they are read again


def check_log(log: Path) -> None:
    """Raise ConfigError unless a drive can be recorded there, and described beside it."""
    if log.suffix not in LOGS:
        raise ConfigError(f"--record {log}: a log ends with {', '.join(LOGS)}")
    for path in (log, description_path(log)):
        if text := replacement_refusal(path, is_forced=False):
            raise ConfigError(text)


class InOrder(can.Listener):
    """Writes the frames of a bus into a log in the order of their times, which several senders do not keep."""

    def __init__(self, log: can.Listener) -> None:
        self._log = log
        self._held: list[tuple[float, int, can.Message]] = []
        self._count = count()

    def on_message_received(self, msg: can.Message) -> None:
        heappush(self._held, (msg.timestamp, next(self._count), msg))
        while self._held[0][0] < msg.timestamp - HELD_S:
            self._log.on_message_received(heappop(self._held)[2])

    def on_error(self, exc: Exception) -> None:
        """Say nothing: who records looks at what the notifier keeps."""

    def stop(self) -> None:
        while self._held:
            self._log.on_message_received(heappop(self._held)[2])
        self._log.stop()


def record(
    asker: SignalAsker, bus: BusConfig, log: Path, duration_s: float | None, controls: Controls, show: Show
) -> None:
    """Write what is said on a bus into a log while a car is driven and asked; raises OutputError, SourceError."""
    end_s = time.monotonic() + (duration_s or float("inf"))
    try:
        writer = can.Logger(log)
        with opened_bus(bus) as heard_bus, can.Notifier(heard_bus, [InOrder(writer)]) as reader:
            begun_s = shown_s = time.monotonic()
            while not controls.stop.is_set and (now_s := time.monotonic()) < end_s:
                if reader.exception is not None:
                    raise reader.exception
                if now_s > shown_s + PROGRESS_S:
                    shown_s = now_s
                    show(f"{(now_s - begun_s) / 60.0:.0f} min, all values {asker.set_count} times")
                time.sleep(LOOK_S)
    except OSError as exc:
        raise OutputError(f"cannot record into {log}: {exc.strerror or exc}") from exc
    except can.CanError as exc:
        raise SourceError(f"recording into {log} ended: {exc}") from exc


def judge(transmission: Transmission, log: Path, words: list[str], controls: Controls, show: Show) -> list[str]:
    """Diagnose the first drive of a vehicle; return the words by which later commands know the vehicle.

    A Ctrl-C that ended the drive does not end this; the next one does.
    """
    controls.stop.rearm()

    def run(command: list[str]) -> None:
        show(f"$ {PROGRAM} {shlex.join(command)}")
        command_line.main(command, PROGRAM, standalone_mode=False, obj=controls)

    return transmission.judge(log, words, run, show)
