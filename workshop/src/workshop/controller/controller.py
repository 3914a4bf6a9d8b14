"""One controller that runs: it keeps the state between requests and has it on the disk before anything is answered."""

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
        What the controller knows: the file may hold nothing else.

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
        """Return what was kept, None if there is no file yet.

        Raises RecordError if the file cannot be read, is damaged, or holds what the table does not describe.
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
        """Write what is to be kept, if it has changed; it is on the disk when this returns.

        Raises RecordError if the disk is full or cannot be written; the file is as it was before.
        """
        kept = msgspec.to_builtins(state.kept, str_keys=True, order="deterministic")
        document = {"format": FORMAT, "kept": kept}
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


def _checked(kept: KeptState, table: DiagnosticTable) -> KeptState:
    """Return what was kept, with an empty record for each code that is new; RecordError: the table is of another."""
    emissions = kept.emissions
    codes = {*kept.memory.records, *emissions.permanent, *([emissions.frame.code] if emissions.frame else [])}
    if unknown := sorted(codes - table.troubles.keys()):
        raise RecordError(f"trouble code {unknown[0]:06X} is not in the table {table.name}")
    for number, data in kept.written.items():
        datum = table.data.get(number)
        if datum is None or datum.write is None or len(data) != datum.size_bytes:
            raise RecordError(f"data {number:04X} of {len(data)} bytes cannot be written by the table {table.name}")
    if unknown := sorted(kept.wrong_keys.keys() - table.levels.keys()):
        raise RecordError(f"security level {unknown[0]} is not in the table {table.name}")
    records = {**empty_memory(table.troubles).records, **kept.memory.records}
    return replace(kept, memory=replace(kept.memory, records=records))


LONGEST_SEED_BYTES: Final = 16
TICK_S: Final = 0.01  # about so often a transport calls `tick`


class Controller:
    """A diagnostic server that several threads may use: one that answers, one that drives and monitors.

    Parameters
    ----------
    table
        What it can be asked.
    values
        Returns the values of the vehicle now, by source.
    clock
        Returns a time [s] that never goes back.
    chance
        Returns so many random bytes.
    store
        The file that keeps what outlives a restart; without one, nothing does.
    work
        Takes a part of the time that an answer takes: called before the values for it are read, and after.

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
        """Whether it starts again after a reset, and neither hears nor says anything."""
        return self._clock() < self._state.asleep_until_s

    def ask(self, payload: bytes, *, is_functional: bool = False, client: int = 0) -> bytes | None:
        """Return the response to a client's request, None if there is none; what it changed is on the disk by then."""
        return self.consider(payload, is_functional=is_functional, client=client).payload

    def consider(self, payload: bytes, *, is_functional: bool = False, client: int = 0) -> Reply:
        """Return the same as ``ask`` with what was kept back, for a transport that has told the client to wait."""
        request = Request(payload=payload, is_functional=is_functional, client=client)
        with self._lock:
            self._work()
            reply = self._kept(server.answer(self.table, self._state, request, self._moment()), payload)
            self._work()
            return reply

    def tick(self, client: int = 0) -> bytes | None:
        """Return a client's response that has become due; to be called about every 10 ms, never waits."""
        if not self._lock.acquire(blocking=False):
            return None
        try:
            waiting = self._state.waiting
            if waiting is not None and waiting.request.client != client:
                return None
            payload = waiting.request.payload if waiting is not None else b""
            return self._kept(server.advance(self.table, self._state, self._moment()), payload).payload
        finally:
            self._lock.release()

    def datum(self, number: int) -> bytes:
        """Return what a datum holds now, nothing if there is none."""
        described = self.table.data.get(number)
        return b"" if described is None else data_of(described, self._state, self._moment())

    def awaits(self, client: int) -> bool:
        """Return whether a response for a client comes later."""
        waiting = self._state.waiting
        return waiting is not None and waiting.request.client == client

    def leave(self, client: int) -> None:
        """Note that a client has gone, and with it the session that it held; raises RecordError as ``report``."""
        self._change(lambda state: server.left(state, client))

    def broadcast(self, client: int = 0) -> tuple[bytes, ...]:
        """Return what is to be sent now to the client who holds the session, without being asked again; as ``tick``."""
        if not self._state.periodic or self._state.holder != client or not self._lock.acquire(blocking=False):
            return ()
        try:
            messages, self._state = server.broadcast(self.table, self._state, self._moment())
            return messages
        finally:
            self._lock.release()

    def hold_session(self) -> None:
        """Begin S3 anew: a message comes in or goes out, and that is not silence; to be called often, never waits."""
        if not self._lock.acquire(blocking=False):
            return
        try:
            if self._state.holder == 0:  # CAN's own: other transports have no messages of many frames
                self._state = server.held(self.table, self._state, self._moment())
        finally:
            self._lock.release()

    def report(self, number: int, result: TestResult) -> None:
        """Take the result of a monitor; raises RecordError if it cannot be kept."""
        self._change(lambda state: server.tested(self.table, state, number, result, self._moment()))

    def warm_up(self) -> None:
        """Note that the vehicle has become warm in this operation cycle; raises RecordError as ``report``."""
        self._change(server.warmed_up)

    def cycle(self) -> None:
        """Begin a new operation cycle; raises RecordError as ``report``."""
        self._change(lambda state: server.cycled(self.table, state))

    def finish(self, routine: int) -> None:
        """Note that the vehicle has done what a routine asked for."""
        self._change(lambda state: finished(state, self.table, routine, self._moment()))

    def fail(self, routine: int, nrc: int = Nrc.PROGRAMMING_FAILURE) -> None:
        """Note that the vehicle could not do what a routine asked for, and why, for who awaits it."""
        self._change(lambda state: failed(state, routine, nrc))

    def adapt(self, adaptation: Adaptation) -> None:
        """Keep what was adapted, or cleared; raises RecordError as ``report``."""
        self._change(lambda state: replace(state, adaptation=adaptation))

    def _change(self, change: Callable[[ServerState], ServerState]) -> None:
        with self._lock:
            state = change(self._state)
            self._save(state)
            self._state = state

    def _kept(self, reply: Reply, payload: bytes) -> Reply:
        """Return a reply once its state is on the disk; what cannot be kept is refused and forgotten."""
        try:
            self._save(reply.state)
        except RecordError:
            self._state = replace(self._state, waiting=None)
            refused = bytes([NEGATIVE, payload[0], Nrc.PROGRAMMING_FAILURE]) if payload else None
            return Reply(payload=refused, state=self._state)
        self._state = reply.state
        return reply

    def _save(self, state: ServerState) -> None:
        if self._store is not None and not state.keeps_as(self._state):
            self._store.save(state)

    def _moment(self) -> Instant:
        return Instant(t_s=self._clock(), values=self._values(), chance=self._chance(LONGEST_SEED_BYTES))
