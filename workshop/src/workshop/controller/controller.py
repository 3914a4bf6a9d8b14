"""One running controller: it holds the state between requests and saves it before it answers."""

import hashlib
import json
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final, Self

import msgspec

from canlog.files import read_small_file
from clutchdiag_io.files import OPEN_FLAGS, PRIVATE_MODE, lock
from ecu_emulator.errors import RecordError
from workshop.controller import server
from workshop.controller.clutches import Adaptation
from workshop.controller.descriptions import Values
from workshop.controller.iso14229 import NEGATIVE, Nrc
from workshop.controller.memory import TestResult, empty_memory
from workshop.controller.services.data import data_of
from workshop.controller.services.sessions import failed, finished
from workshop.controller.state import Instant, KeptState, Reply, Request, ServerState
from workshop.controller.table import DiagnosticTable

FORMAT: Final = 2


class MemoryFile:
    """The file of one controller; while it is open, no other process can use it.

    Parameters
    ----------
    path
        Where it is, or shall be.
    table
        Description of the controller; other codes or data in the file are an error.

    Raises
    ------
    RecordError
        If another process uses the file, or it cannot be made.
    """

    def __init__(self, path: Path, table: DiagnosticTable) -> None:
        self._path = path
        self._table = table
        self._saved = ""  # its digest
        self._lock = -1

    def __enter__(self) -> Self:
        try:
            self._lock = os.open(self._beside("lock"), OPEN_FLAGS, PRIVATE_MODE)
            lock(self._lock)
        except BlockingIOError as exc:
            os.close(self._lock)
            raise RecordError(f"{self._path} is used by another process") from exc
        except OSError as exc:
            raise RecordError(f"cannot lock {self._path}: {exc.strerror}") from exc
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._lock)

    def load(self) -> KeptState | None:
        """Return the saved state, None if there is no file yet.

        Raises RecordError if the file cannot be read, is damaged, or holds codes or data that the table lacks.
        """
        try:
            document = json.loads(read_small_file(self._path))
        except FileNotFoundError:
            return None
        except OSError as exc:
            raise RecordError(f"cannot read {self._path}: {exc.strerror or exc}") from exc
        except (ValueError, RecursionError) as exc:
            raise self._damaged("not JSON") from exc
        digest = document.pop("sha256", None) if isinstance(document, dict) else ""
        if digest != _digest(document):
            raise self._damaged("its checksum does not fit")
        if document.get("format") != FORMAT:
            raise RecordError(f"{self._path} has format {document.get('format')}, this program knows {FORMAT}")
        self._saved = digest
        try:
            return _checked(msgspec.convert(document.get("kept"), KeptState, str_keys=True), self._table)
        except msgspec.ValidationError as exc:
            raise self._damaged(str(exc)) from exc
        except RecordError as exc:
            raise RecordError(f"{self._path}: {exc}") from exc

    def save(self, state: ServerState) -> None:
        """Save the state if it has changed; it is on the disk when this returns.

        Raises RecordError if the disk is full or cannot be written; the file is as it was before.
        """
        content = msgspec.to_builtins(state.kept, str_keys=True, order="deterministic")
        document = {"format": FORMAT, "kept": content}
        if (digest := _digest(document)) == self._saved:
            return
        temporary = self._beside("part")
        text = json.dumps({**document, "sha256": digest}, indent=1, sort_keys=True)
        try:
            descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, PRIVATE_MODE)
            with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
                stream.write(text + "\n")
                stream.flush()
                os.fsync(stream.fileno())
            temporary.replace(self._path)
            _sync_folder(self._path.absolute().parent)
        except OSError as exc:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise RecordError(f"cannot write {self._path}: {exc.strerror or exc}") from exc
        self._saved = digest

    def _beside(self, suffix: str) -> Path:
        return self._path.with_name(f".{self._path.name}.{suffix}")

    def _damaged(self, why: str) -> RecordError:
        return RecordError(f"{self._path} is damaged ({why}); move it away to begin with an empty memory")


def _sync_folder(folder: Path) -> None:
    """Make a new name durable."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _digest(document: object) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode("utf-8")).hexdigest()


def _checked(state: KeptState, table: DiagnosticTable) -> KeptState:
    """Return the saved state with empty records for new codes; raises RecordError if the table lacks something."""
    emissions = state.emissions
    codes = {*state.memory.records, *emissions.permanent, *([emissions.frame.code] if emissions.frame else [])}
    if unknown := sorted(codes - table.troubles.keys()):
        raise RecordError(f"trouble code {unknown[0]:06X} is not in the table {table.name}")
    for number, data in state.written.items():
        datum = table.data.get(number)
        if datum is None or datum.write is None or len(data) != datum.size_bytes:
            raise RecordError(f"data {number:04X} of {len(data)} bytes cannot be written by the table {table.name}")
    if unknown := sorted(state.wrong_keys.keys() - table.levels.keys()):
        raise RecordError(f"security level {unknown[0]} is not in the table {table.name}")
    records = {**empty_memory(table.troubles).records, **state.memory.records}
    return replace(state, memory=replace(state.memory, records=records))


LONGEST_SEED_BYTES: Final = 16
TICK_S: Final = 0.01  # period at which transports call `tick`


class Controller:
    """A diagnostic server, safe for several threads: transports ask it, the drive reports test results.

    Parameters
    ----------
    table
        Description of the controller.
    values
        Returns the present values of the vehicle, by source.
    clock
        Returns monotonic time [s].
    chance
        Returns so many random bytes.
    store
        The memory file; without one nothing survives a restart.
    work
        Sleeps for half of the time to answer: called before and after the values are read.

    Raises
    ------
    RecordError
        If the file cannot be read or written.
    """

    def __init__(
        self,
        table: DiagnosticTable,
        *,
        values: Callable[[], Values],
        clock: Callable[[], float],
        chance: Callable[[int], bytes],
        store: MemoryFile | None = None,
        work: Callable[[], None] = lambda: None,
    ) -> None:
        self.table = table
        self._values = values
        self._clock = clock
        self._chance = chance
        self._store = store
        self._work = work
        self._lock = threading.Lock()
        self._state = server.switched_on(table, store.load() if store is not None else None, clock())
        if store is not None:
            store.save(self._state)

    @property
    def state(self) -> ServerState:
        return self._state

    @property
    def is_asleep(self) -> bool:
        """Whether it restarts after a reset and ignores requests."""
        return self._clock() < self._state.asleep_until_s

    def ask(self, payload: bytes, *, is_functional: bool = False, client: int = 0) -> bytes | None:
        """Return the response to a client's request, None if there is none; the new state has been saved."""
        return self.reply_to(payload, is_functional=is_functional, client=client).payload

    def reply_to(self, payload: bytes, *, is_functional: bool = False, client: int = 0) -> Reply:
        """Return the reply with a suppressed response, which a transport that has sent 78 needs."""
        request = Request(payload=payload, is_functional=is_functional, client=client)
        with self._lock:
            self._work()
            reply = self._saved(server.answer(self.table, self._state, request, self._moment()), payload)
            self._work()
            return reply

    def tick(self, client: int = 0) -> bytes | None:
        """Return a client's response that has become due; does not block; call it every ``TICK_S``."""
        if not self._lock.acquire(blocking=False):
            return None
        try:
            waiting = self._state.waiting
            if waiting is not None and waiting.request.client != client:
                return None
            payload = waiting.request.payload if waiting is not None else b""
            return self._saved(server.advance(self.table, self._state, self._moment()), payload).payload
        finally:
            self._lock.release()

    def datum(self, number: int) -> bytes:
        """Return the present bytes of a datum, empty if it is unknown."""
        described = self.table.data.get(number)
        return b"" if described is None else data_of(described, self._state, self._moment())

    def awaits(self, client: int) -> bool:
        """Return whether a response for a client is pending."""
        waiting = self._state.waiting
        return waiting is not None and waiting.request.client == client

    def leave(self, client: int) -> None:
        """End a client's session and pending response; raises RecordError as ``report``."""
        self._change(lambda state: server.disconnect(state, client))

    def hold_session(self) -> None:
        """Restart S3 while a message is being transferred; does not block."""
        if not self._lock.acquire(blocking=False):
            return
        try:
            if self._state.holder == 0:  # CAN: other transports do not segment messages
                self._state = server.extend_session(self.table, self._state, self._moment())
        finally:
            self._lock.release()

    def report(self, number: int, result: TestResult) -> None:
        """Record the result of a monitor; raises RecordError if it cannot be saved."""
        self._change(lambda state: server.tested(self.table, state, number, result, self._moment()))

    def warm_up(self) -> None:
        """Mark this operation cycle as a warm-up cycle; raises RecordError as ``report``."""
        self._change(server.warmed_up)

    def cycle(self) -> None:
        """Begin a new operation cycle; raises RecordError as ``report``."""
        self._change(lambda state: server.cycled(self.table, state))

    def finish(self, routine: int) -> None:
        """End a routine that the vehicle has completed."""
        self._change(lambda state: finished(state, self.table, routine, self._moment()))

    def fail(self, routine: int, nrc: int = Nrc.PROGRAMMING_FAILURE) -> None:
        """End a routine that the vehicle could not complete, with the response code for the waiting client."""
        self._change(lambda state: failed(state, routine, nrc))

    def adapt(self, adaptation: Adaptation) -> None:
        """Save an adaptation, or its clearing; raises RecordError as ``report``."""
        self._change(lambda state: replace(state, adaptation=adaptation))

    def _change(self, change: Callable[[ServerState], ServerState]) -> None:
        with self._lock:
            state = change(self._state)
            self._save(state)
            self._state = state

    def _saved(self, reply: Reply, payload: bytes) -> Reply:
        """Save the state of a reply and return it; if that fails, refuse the request and drop its state."""
        try:
            self._save(reply.state)
        except RecordError:
            self._state = replace(self._state, waiting=None)
            refused = bytes([NEGATIVE, payload[0], Nrc.PROGRAMMING_FAILURE]) if payload else None
            return Reply(payload=refused, state=self._state)
        self._state = reply.state
        return reply

    def _save(self, state: ServerState) -> None:
        if self._store is not None and not state.keeps_same_as(self._state):
            self._store.save(state)

    def _moment(self) -> Instant:
        return Instant(t_s=self._clock(), values=self._values(), chance=self._chance(LONGEST_SEED_BYTES))
