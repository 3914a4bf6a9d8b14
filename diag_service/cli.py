"""The command line of the service: words to configuration, errors to one line and an exit status."""

import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Final

from canlog.errors import DefinitionError, ExtraMissingError, InputLeftError, OutputError, SourceError
from canlog.files import widen
from clutchdiag_io.command_line import STANDARD_STREAM
from clutchdiag_io.program import Kinds, attached, complain, reckon_in_one_thread, standard_output
from diag_service.commands.arguments import (
    COMMAND_LINE,
    EXIT_CONFIG,
    EXIT_INCOMPLETE,
    EXIT_OK,
    EXIT_SIGNALLED,
    EXIT_SOURCE,
    EXIT_STORE,
)
from diag_service.errors import ConfigError, ControllerError, IncompleteError, StoppedError, StoreError
from diag_service.service.stopping import Controls, PatientTrigger, Trigger, ignore
from diag_service.settings.options import PROGRAM

ENDED_BY_SIGNALS: Final = ("run", "monitor")  # as a rule
COUNTS_WANTED: Final = tuple(number for number in signal.Signals if number.name == "SIGUSR1")  # POSIX alone has it


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the service and return its exit status."""
    reckon_in_one_thread()
    controls = Controls()
    controls.stop.listen_to(signal.SIGINT, signal.SIGTERM)
    controls.counts_wanted.listen_to(*COUNTS_WANTED)
    try:
        is_verbose = False
        try:
            options = COMMAND_LINE.parse(arguments)
            is_verbose = options.verbose > 0
            with standard_output():
                _run(options, controls)
        except (StoppedError, InputLeftError) as exc:
            return _end_early(exc, controls.stop, is_usual=options.command in ENDED_BY_SIGNALS)
        except Exception as exc:  # noqa: BLE001 - the one place where nothing may pass
            return complain(PROGRAM, exc, _statuses(), is_verbose=is_verbose, hint=" (-v shows where)")
        return EXIT_OK
    finally:
        if arguments is None:  # a signal while the interpreter winds down must not change the exit status
            ignore(signal.SIGINT, signal.SIGTERM, *COUNTS_WANTED)


def _statuses() -> Sequence[tuple[Kinds, int]]:
    """Return the exit status of each kind of error."""
    from clutch_model.errors import CalibrationError

    return (
        ((ConfigError, CalibrationError, DefinitionError, ExtraMissingError), EXIT_CONFIG),
        ((SourceError, ControllerError), EXIT_SOURCE),
        ((StoreError, OutputError), EXIT_STORE),
        (IncompleteError, EXIT_INCOMPLETE),
    )


def _run(options: SimpleNamespace, controls: Controls) -> None:
    # python-can loads asammdf where it is installed, and that pandas: 0.3 s, 45 MB. Who reads MF4 loads it then.
    sys.modules.setdefault("asammdf", None)  # type: ignore[arg-type]  # Python's own way to say "not here"
    logs = _logs(options)
    is_piped = STANDARD_STREAM in logs
    if is_piped:
        with suppress(AttributeError, OSError, ValueError):  # none, or none of the system: reading it says so
            widen(sys.stdin.fileno())  # whoever writes goes on meanwhile: candump loses frames once the pipe is full
    # Imported here: compiled libraries take a second, in which a signal must already find its handler.
    from canlog.jit import on_compiling
    from diag_service.console import set_up_notices

    set_up_notices(options.verbose)
    execute = execute_of(options.command)
    if is_piped:  # whoever writes into the pipe may get the same signal, and end it
        controls = replace(controls, stop=PatientTrigger(controls.stop))
    unheed = on_compiling(lambda _kernel: None if is_piped else _check(controls.stop))  # what came by a pipe is judged
    try:
        execute(options, controls)
    except SourceError as exc:
        if text := _about_store(options):
            raise ConfigError(text) from exc
        raise
    finally:
        unheed()


def execute_of(command: str) -> Callable[[SimpleNamespace, Controls], None]:  # noqa: C901, PLR0912 - a case per command
    """Return what carries out a command, and load that only."""
    match command:
        case "analyze":
            from diag_service.commands.analyze import execute
        case "calibrate":
            from diag_service.commands.learn import calibrate as execute
        case "config":
            from diag_service.commands.live import config as execute
        case "decode":
            from diag_service.commands.decode import execute
        case "fluid-changed":
            from diag_service.commands.store import fluid_changed as execute
        case "history":
            from diag_service.commands.store import history as execute
        case "inspect":
            from diag_service.commands.inspect import execute
        case "lake":
            from diag_service.commands.lake import execute
        case "learn":
            from diag_service.commands.learn import learn as execute
        case "monitor":
            from diag_service.commands.live import monitor as execute
        case "predict":
            from diag_service.commands.learn import predict as execute
        case "report":
            from diag_service.commands.store import report as execute
        case "run":
            from diag_service.commands.live import run as execute
        case "show":
            from diag_service.commands.store import show as execute
        case "signals":
            from diag_service.commands.inspect import propose as execute
        case "transmission":
            from diag_service.commands.transmission import execute
        case _:
            execute = attached("diag_service.commands")[command].execute
    return execute


def _about_store(options: SimpleNamespace) -> str | None:
    """Return what there is to say to who takes a store of results for a log."""
    from diag_service.store.reading import is_store

    for path in _logs(options):
        if isinstance(path, Path) and is_store(path):
            return f"{path} is a store of results, no log: {PROGRAM} report {path} shows what is in it"
    return None


def _logs(options: SimpleNamespace) -> Sequence[Path | str]:
    return (getattr(options, "log", None) or "", *getattr(options, "logs", ()))


def _check(stop: Trigger) -> None:
    """Raise StoppedError if a run was told to stop: compiling can take minutes."""
    if stop.is_set:
        raise StoppedError("stopped early: numerical kernels were being compiled")


def _end_early(exc: Exception, stop: Trigger, *, is_usual: bool) -> int:
    """Say that a run was stopped and return the exit status; a reader that hung up wants to hear no more."""
    if stop.signal is None:
        return EXIT_OK
    sys.stderr.write(f"{PROGRAM}: {exc}\n")
    return EXIT_OK if is_usual else EXIT_SIGNALLED + stop.signal
