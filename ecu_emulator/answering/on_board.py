"""An estimate on board: a diag-service beside the controller, as a process of its own on the same bus.

The two meet on the bus and in a pipe of JSON lines, not in Python.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import IO, Final, Protocol, Self

from ecu_emulator.diagnostics.clutches import OnBoardEstimates, OnBoardFriction, read_line

LONGEST_LINE: Final = 1 << 20
LONGEST_COMPLAINT: Final = 1 << 16
LONGEST_TOLD: Final = 500
MOST_STARTS: Final = 6  # in a row that did not last
LASTED_S: Final = 60.0
FIRST_PAUSE_S: Final = 1.0  # doubled with each start in a row
END_S: Final = 5.0  # how long the service may take to end
NOTE_S: Final = 45.0  # how long it may take to note new fluid
NEW_FLUID_NOTE: Final = "adaptation cleared by a tester"
NOTHING_LEARNED: Final = "holds no results"  # what the service says of a store that no event has reached yet
_OWN_VARIABLES: Final = "CLUTCHDIAG_"  # of a user's service: its broker, store and vehicle are not this one's
# The kernel ends the service with this process, however that ends; if it has ended already, nobody is the parent.
_LAUNCH: Final = """
import ctypes, os, runpy, signal, sys
ctypes.CDLL(None).prctl(1, signal.SIGTERM)
if os.getppid() != int(sys.argv[1]):
    sys.exit(0)
sys.argv[:2] = ["diag-service"]
runpy.run_module("diag_service", run_name="__main__")
"""


class EstimateSource(AbstractContextManager[object], Protocol):
    """Where the controller's estimate of its clutches comes from, while it is entered."""

    @property
    def estimates(self) -> OnBoardEstimates:
        """What is thought now."""

    @property
    def is_live(self) -> bool:
        """Whether it follows what is driven."""

    @property
    def problem(self) -> str | None:
        """Why nothing is thought any more, for people."""

    def begin_anew(self) -> bool:
        """Forget what was learned of the old fluid; return whether that is done. May take seconds."""


class FixedEstimate:
    """The same estimate all the time, of both clutches; without one, none."""

    problem = None
    is_live = False

    def __init__(self, estimate: OnBoardFriction | None) -> None:
        self.estimates: OnBoardEstimates = {} if estimate is None else {1: estimate, 2: estimate}

    def begin_anew(self) -> bool:
        """Return that nothing was learned that could be forgotten."""
        return False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...


class Complaints:
    """What a program says on standard error, of which the end is kept: a program may complain for weeks.

    Parameters
    ----------
    stream
        The reading end; it is read to its end.
    """

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._end = b""
        self._thread = threading.Thread(target=self._read, name="on board, complaints", daemon=True)
        self._thread.start()

    def last_line(self, wait_s: float) -> str:
        """Return the last line that says something, empty if there is none; waits so long for the end [s]."""
        self._thread.join(wait_s)
        lines = self._end.decode("utf-8", errors="replace").split("\n")
        return next((line for line in reversed(lines) if line.strip()), "")[:LONGEST_TOLD]

    def _read(self) -> None:
        with suppress(OSError, ValueError):  # closed by who no longer waits for it; a buffer would make that one wait
            while piece := os.read(self._stream.fileno(), LONGEST_COMPLAINT):
                self._end = (self._end + piece)[-LONGEST_COMPLAINT:]


class OnBoardService:
    """A diag-service on the same bus, started again if it ends, a few times; ends with this object and this process.

    Parameters
    ----------
    bus
        The words that name the bus on a command line.
    store
        Where it keeps what it has learned; None: it forgets.
    program
        What is started, for tests: the interpreter's arguments up to those of the service.
    first_pause_s
        Before the second start.
    """

    is_live = True

    def __init__(
        self,
        bus: Sequence[str],
        store: Path | None,
        *,
        program: Sequence[str] | None = None,
        first_pause_s: float = FIRST_PAUSE_S,
    ) -> None:
        self._bus = bus
        self._store = store
        self._program = program or (sys.executable, "-c", _LAUNCH, str(os.getpid()))
        self._first_pause_s = first_pause_s
        self._folder = Path()
        self._is_over = threading.Event()
        self._guard = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None
        # A thread that lasts: the kernel's word to end with the parent is about the thread that started a child.
        self._thread = threading.Thread(target=self._run, name="on board", daemon=True)
        self._estimates: dict[int, OnBoardFriction] = {}
        self._anew_ns = 0  # when new fluid was noted: what ended before that is of the old one
        self.problem: str | None = None
        self.start_count = 0

    @property
    def estimates(self) -> OnBoardEstimates:
        """What the service found of each clutch, by its latest result."""
        return self._estimates

    def begin_anew(self) -> bool:
        """Have the service note new fluid: its friction is learned afresh, what is known of sensors stays."""
        words = ["fluid-changed", str(self._kept_in), "--note", NEW_FLUID_NOTE]
        try:
            noted = subprocess.run(  # noqa: S603 - our own program, with words of our own
                [*self._program, *words],
                check=False, stdin=subprocess.DEVNULL, capture_output=True, timeout=NOTE_S,
                env=without_settings(os.environ),
            )  # fmt: skip
        except (OSError, subprocess.TimeoutExpired):
            return False
        if noted.returncode and NOTHING_LEARNED.encode() not in noted.stderr:
            return False
        self._anew_ns = time.time_ns()
        self._estimates = {}
        return True

    @property
    def _kept_in(self) -> Path:
        return self._store or self._folder / "on-board.sqlite"

    def __enter__(self) -> Self:
        self._folder = Path(tempfile.mkdtemp(prefix="on-board-"))
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._guard:
            self._is_over.set()
            if self._child is not None:
                self._child.terminate()
        self._thread.join(END_S)
        if self._thread.is_alive() and self._child is not None:
            self._child.kill()
            self._thread.join(END_S)
        shutil.rmtree(self._folder, ignore_errors=True)

    def _run(self) -> None:
        in_a_row = 0
        while not self._is_over.is_set():
            began_s = time.monotonic()
            ending = self._serve()
            in_a_row = 1 if time.monotonic() - began_s >= LASTED_S else in_a_row + 1
            if self._is_over.is_set():
                return
            if in_a_row >= MOST_STARTS:
                self.problem = f"the service on board ended {in_a_row} times in a row: {ending}"
                self._estimates = {}
                return
            self._is_over.wait(self._first_pause_s * 2.0 ** (in_a_row - 1))

    def _serve(self) -> str:
        """Start the service, take what it says until it ends, and return how that was."""
        try:
            child = self._started()
        except OSError as exc:
            return str(exc)
        if child is None or child.stdout is None or child.stderr is None:
            return "it was not started"
        with child:
            complaints = Complaints(child.stderr)
            while line := child.stdout.readline(LONGEST_LINE):
                found = read_line(line)
                if found is not None and (not found[1].end_ns or found[1].end_ns >= self._anew_ns):
                    self._estimates = {**self._estimates, found[0]: found[1]}
            child.wait()
            return complaints.last_line(END_S) or f"status {child.returncode}"

    def _started(self) -> "subprocess.Popen[bytes] | None":
        with self._guard:
            if self._is_over.is_set():
                return None
            self.start_count += 1
            self._child = subprocess.Popen(  # noqa: S603 - our own program, with words that this program checked
                [*self._program, "run", *self._bus, "--store", str(self._kept_in), "--json"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env=without_settings(os.environ),
            )
            return self._child


def without_settings(variables: Mapping[str, str]) -> dict[str, str]:
    """Return an environment in which nothing tells the service more than its command line."""
    return {name: value for name, value in variables.items() if not name.startswith(_OWN_VARIABLES)}
