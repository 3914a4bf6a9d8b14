"""Command line of the emulator: arguments, signals and exit status; what the commands do is in ``commands``."""

import math
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from threading import Event
from types import SimpleNamespace
from typing import TYPE_CHECKING, Final

from clutchdiag_io.program import attached, complain, refusal, standard_output
from ecu_emulator.arguments import COMMAND_LINE, PROGRAM
from ecu_emulator.errors import BusError, EmulatorConfigError, EmulatorStoppedError, LogFormatExtraError, RecordError

if TYPE_CHECKING:
    from types import FrameType

STATUS_SIGNALLED: Final = 128  # and the number of the signal, as a shell tells it
STATUS_INTERRUPTED: Final = 130  # SIGINT again, without waiting for the clean stop
STATUSES: Final = (((EmulatorConfigError, LogFormatExtraError), 2), (BusError, 3), (RecordError, 4))
PATIENCE_S: Final = 1.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program and return its exit status."""
    with _stop_on_signals(is_program=arguments is None) as stop:
        options = COMMAND_LINE.parse(arguments)
        is_whole = True
        try:
            with standard_output():
                is_whole = _execute(options, stop)
        except EmulatorStoppedError as exc:
            sys.stderr.write(f"{PROGRAM}: {exc}\n")
            is_whole = options.command == "run"  # whose usual end is a signal
        except KeyboardInterrupt:
            sys.stderr.write(f"{PROGRAM}: error: interrupted\n")
            return STATUS_INTERRUPTED
        except Exception as exc:  # noqa: BLE001 - the one place where nothing may escape
            return complain(PROGRAM, exc, STATUSES, is_verbose=options.verbose)
    return 0 if is_whole or stop.number is None else STATUS_SIGNALLED + stop.number


class _Stop(Event):
    """Set by a signal, which it knows."""

    number: int | None = None

    def check(self, _kernel: str) -> None:
        """Raise StoppedError if it is set: compiling can take minutes."""
        if self.is_set():
            raise EmulatorStoppedError("stopped early: numerical kernels were being compiled, nothing was driven")


def _execute(options: SimpleNamespace, stop: _Stop) -> bool:
    """Run a command; return whether it did all of what it was to do."""
    with _without("asammdf"):  # python-can loads it where it is installed, and that pandas: 0.3 s for nothing
        from canlog.jit import announce_compiling, on_compiling  # noqa: PLC0415 - heavy; signals are in hand before
        from ecu_emulator import commands, live  # noqa: PLC0415 - likewise

    silence = announce_compiling(lambda line: sys.stderr.write(f"{PROGRAM}: {line}\n"))
    unheed = on_compiling(stop.check)
    try:
        if options.command == "scenarios":
            commands.list_scenarios()
            return True
        if options.command == "dbc":
            commands.save_dbc(options.output, is_forced=options.force, transmission=options.transmission)
            return True
        scenario = commands.choose_scenario(commands.drive_options(options))
        if options.command == "record":
            log = commands.LogOptions(
                path=options.file,
                log_format=options.format,
                start_ns=options.start_time,
                channel=options.channel,
                truth=options.truth,
                longest_stay_s=options.parked,
            )
            return commands.record(scenario, log, stop, is_json=options.json, is_forced=options.force)
        answers = attached("ecu_emulator.answers").get("chosen", lambda _options: None)
        written = (options.truth, options.summary)
        kept = (options.control, options.alive, vars(options).get("diagnostic_memory"))
        if text := refusal(*written, is_forced=options.force) or refusal(*written, *kept, is_forced=True):
            raise EmulatorConfigError(text)
        live.run(
            scenario,
            choice=live.BusChoice(
                interface=options.interface, channel=options.channel, bitrate=options.bitrate, is_fd=options.fd
            ),
            truth=options.truth,
            summary=options.summary,
            control=options.control,
            alive=options.alive,
            answers=answers(options),
            start_delay_s=options.start_delay,
            longest_stay_s=options.parked,
            is_json=options.json,
            stop=stop,
        )
        return True
    finally:
        unheed()
        silence()  # a program that called this one prints nothing of its own


@contextmanager
def _without(module: str) -> Iterator[None]:
    """Let a module seem not to be installed."""
    is_hidden = sys.modules.setdefault(module, None) is None  # type: ignore[arg-type]  # Python's own way to say so
    try:
        yield
    finally:
        if is_hidden:
            del sys.modules[module]


@contextmanager
def _stop_on_signals(*, is_program: bool) -> Iterator[_Stop]:
    """Turn SIGINT and SIGTERM into a request to stop; a SIGINT much later interrupts what does not heed it.

    A program ignores both in the end: one that comes while the interpreter winds down must not change the exit status.
    """
    stop = _Stop()
    deadline_s = math.inf

    def request(number: int, _frame: "FrameType | None") -> None:
        nonlocal deadline_s
        now_s = time.monotonic()
        if number == signal.SIGINT and now_s > deadline_s:
            raise KeyboardInterrupt
        stop.number = stop.number or number
        deadline_s = min(deadline_s, now_s + PATIENCE_S)  # a terminal and a wrapper may both hand on the same Ctrl-C
        stop.set()

    before = {number: signal.signal(number, request) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if is_program else handler)
