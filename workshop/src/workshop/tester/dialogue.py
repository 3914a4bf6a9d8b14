"""Questions to one controller: time to answer, answers that come late or for others, a controller that is busy."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Final, Self

from diag_service.errors import ControllerError, MalformedError, PendingError, RefusedError, SilentError, StoppedError
from workshop.tester.answers import (
    BUSY,
    DEFAULT_SESSION,
    SECURITY,
    SESSION,
    STOPPED,
    DialogueCounts,
    Timing,
    belongs,
    fault,
    refusal_text,
    request_text,
    shown,
)
from workshop.tester.libraries import (
    BaseConnection,
    Client,
    InvalidResponseException,
    NegativeResponseException,
    Request,
    TimeoutException,
    UnexpectedResponseException,
    default_client_config,
)

LOOK_S: Final = 0.1  # how soon it notices that it shall stop
_KEY: Final = 1  # added to the level that asked for the seed
_LOGGER: Final = "diag_service"  # the library adds its own name, and warns there of every refusal
logging.getLogger(f"UdsClient[{_LOGGER}]").addHandler(logging.NullHandler())


class Dialogue:
    """Asks one controller, one question at a time.

    Parameters
    ----------
    connection
        To the controller; opened and closed by this object, which is a context manager.
    where
        Who is asked, for people.
    timing
        How patient it is.
    pause
        Waits for so many seconds; by default it notices when it shall stop.
    goes_on
        Asked while an answer is waited for; False ends that with StoppedError.
    """

    def __init__(
        self,
        connection: BaseConnection,
        where: str,
        timing: Timing | None = None,
        *,
        pause: Callable[[float], object] | None = None,
        goes_on: Callable[[], bool] = lambda: True,
    ) -> None:
        self.where = where
        self.timing = timing or Timing()
        self.counts = DialogueCounts()
        self._goes_on = goes_on
        self._pause = pause or self._rest
        self._filter = _Matching(connection, self.counts, goes_on)
        self._pending = 0
        self._client = Client(self._filter, _client_config(self.timing, self._note_pending))
        self._last_s = float("-inf")

    def __enter__(self) -> Self:
        self._client.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()

    def ask(self, request: bytes) -> bytes:
        """Return the positive response to a request, empty if it asked for none.

        A controller that is busy is asked again after a growing pause, one that says nothing once more.

        Raises
        ------
        RefusedError, SilentError
            If it will not, or does not answer.
        MalformedError
            If its answer breaks the rules of the standard.
        ControllerError
            If the connection is broken.
        """
        busy = silent = 0
        while True:
            try:
                return self._ask_once(request)
            except RefusedError as exc:
                busy += 1
                if exc.code != BUSY or busy > self.timing.most_busy:
                    raise
                self.counts.busy += 1
                self._pause(self.timing.busy_pause_s * 2.0 ** (busy - 1))
            except PendingError:  # it has the question
                raise
            except SilentError:
                silent += 1
                self.counts.silent += 1
                if silent >= self.timing.most_silent:
                    raise

    def _ask_once(self, request: bytes) -> bytes:
        gap_s = self._last_s + self.timing.gap_s - time.monotonic()
        if gap_s > 0.0:
            self._pause(gap_s)
        self.counts.requests += 1
        self._filter.begin(request)
        self._pending = 0
        begun_s = time.monotonic()
        try:
            response = self._client.send_request(Request.from_payload(request))
        except NegativeResponseException as exc:
            self._check(request, bytes(exc.response.original_payload or b""))
            self.counts.refusals += 1
            code = int(exc.response.code or 0)
            text = f"{self.where} refuses {request_text(request)}: {refusal_text(code)}"
            raise RefusedError(text, code) from exc
        except TimeoutException as exc:
            if self._pending:
                times = "once" if self._pending == 1 else f"{self._pending} times"
                text = (
                    f"{self.where} asked for more time {times} in {time.monotonic() - begun_s:.0f} s and never answered"
                )
                raise PendingError(f"{text} {request_text(request)}") from exc
            stray = self._filter.stray
            more = f": what came instead, last {shown(stray)}, does not answer it" if stray else ""
            raise SilentError(f"{self.where} does not answer {request_text(request)}{more}") from exc
        except (InvalidResponseException, UnexpectedResponseException, OSError, RuntimeError) as exc:
            raise ControllerError(f"{self.where}: {' '.join(str(exc).split())}") from exc
        finally:
            self._last_s = time.monotonic()
        if response is None:
            return b""
        return self._check(request, bytes(response.original_payload or b""))

    def _check(self, request: bytes, response: bytes) -> bytes:
        if wrong := fault(request, response):
            text = f"{self.where} answers {request_text(request)} with {shown(response)}, which is not a valid answer"
            raise MalformedError(f"{text}: {wrong}")
        return response

    def _note_pending(self) -> None:
        self._pending += 1

    def _rest(self, duration_s: float) -> None:
        until_s = time.monotonic() + duration_s
        while (left_s := until_s - time.monotonic()) > 0.0:
            if not self._goes_on():
                raise StoppedError(STOPPED)
            time.sleep(min(LOOK_S, left_s))

    def may_ask(self, request: bytes) -> bytes | RefusedError:
        """Return the positive response, or the refusal; raises as ``ask`` otherwise."""
        try:
            return self.ask(request)
        except RefusedError as exc:
            return exc

    @contextmanager
    def session(self, number: int) -> Iterator[None]:
        """Enter a session, and leave it in the end; the default one needs neither."""
        if number == DEFAULT_SESSION:
            yield
            return
        self.ask(bytes([SESSION, number]))
        try:
            yield
        finally:
            with suppress(ControllerError):  # it ends by itself after some seconds of silence
                self.ask(bytes([SESSION, DEFAULT_SESSION]))

    @contextmanager
    def patience(self, longest_s: float) -> Iterator[None]:
        """Give each question so much time, however often the controller says that it takes longer."""
        self._client.set_config("request_timeout", max(longest_s, self.timing.p2_s))
        try:
            yield
        finally:
            self._client.set_config("request_timeout", max(self.timing.longest_s, self.timing.p2_s))

    def unlock(self, level: int, mask: bytes) -> None:
        """Unlock a security level whose key is its seed XOR a mask; one that is unlocked stays so."""
        seed = self.ask(bytes([SECURITY, level]))[2:]
        if not any(seed):
            return
        if len(seed) != len(mask):
            raise ControllerError(f"{self.where} has a seed of {len(seed)} bytes, the mask has {len(mask)}")
        key = bytes(one ^ other for one, other in zip(seed, mask, strict=True))
        self.ask(bytes([SECURITY, level + _KEY]) + key)


def _client_config(timing: Timing, on_pending: Callable[[], None]) -> Any:  # noqa: ANN401 - a typed dictionary of the library, of which this is a part
    return {
        **default_client_config,
        "request_timeout": max(timing.longest_s, timing.p2_s),
        "p2_timeout": timing.p2_s,
        "p2_star_timeout": timing.p2_star_s,
        "nrc78_callback": on_pending,
        "logger_name": _LOGGER,
        "use_server_timing": False,  # a controller tells its own time, not that of the bus and of this machine
    }


class _Matching(BaseConnection):
    """A connection that passes on answers to the last request only: late ones to earlier requests are counted."""

    def __init__(self, inner: BaseConnection, counts: DialogueCounts, goes_on: Callable[[], bool]) -> None:
        super().__init__("matching")
        self._inner = inner
        self._counts = counts
        self._goes_on = goes_on
        self.request = self.stray = b""

    def begin(self, request: bytes) -> None:
        """Wait for answers to this request from now on."""
        self.request, self.stray = request, b""

    def open(self) -> "_Matching":
        self._inner.open()
        return self

    def close(self) -> None:
        self._inner.close()

    def is_open(self) -> bool:
        return self._inner.is_open()

    def empty_rxqueue(self) -> None:
        self._inner.empty_rxqueue()

    def specific_send(self, payload: bytes, timeout: float | None = None) -> None:
        del timeout
        self._inner.send(payload)

    def specific_wait_frame(self, timeout: float | None = None) -> bytes | None:
        until_s = time.monotonic() + (timeout or 0.0)
        while True:
            left_s = max(0.0, until_s - time.monotonic())
            try:
                payload = self._inner.specific_wait_frame(timeout=min(LOOK_S, left_s))
            except TimeoutException:
                if left_s <= LOOK_S:
                    raise
                payload = b""
            if not self._goes_on():
                raise StoppedError(STOPPED)
            if payload is None or belongs(self.request, payload):
                return payload
            self._counts.stray += bool(payload)
            self.stray = payload or self.stray
