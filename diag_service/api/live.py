"""A live bus from Python: ``async for result in diagnose(bus)``, or in the background of a program without a loop."""

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Self, Unpack

from canlog.live import LiveSource, ReadSchedule
from clutch_results.records import ShiftResult
from diag_service.api import choices
from diag_service.api.analysis import Analysis
from diag_service.console import collected_notices
from diag_service.delivery import ControllerNews, News, Reporter
from diag_service.diagnosis.frame_counts import FrameCounts
from diag_service.diagnosis.summary import Summary, summary_record
from diag_service.errors import ConfigError
from diag_service.service.application import opened_store
from diag_service.service.bus_run import diagnose_source, open_live, serve_bus
from diag_service.service.session import Session
from diag_service.service.snapshot import Snapshot, frame_counts
from diag_service.settings.config import BusConfig, DiagnosisConfig, default_store
from diag_service.settings.options import LiveOptions, bus_config, diagnosis_config
from diag_service.stopping import Controls
from diag_service.store import KeptEvents, ResultStore

if TYPE_CHECKING:
    import can

POLL_S = 0.01


MAX_WAITING = 1000  # results that whoever iterates may be behind


class BackgroundDiagnosis:
    """A bus that is diagnosed while the ``with`` block runs; made by ``LiveDiagnosis.in_background``.

    When the block begins the bus is listened to. What goes wrong later is raised by ``wait_for`` and ``stop``, and at
    the end of a block that has not failed itself.
    """

    def __init__(self, diagnosis: "LiveDiagnosis") -> None:
        self._diagnosis = diagnosis
        self._is_begun = threading.Event()
        self._run = Future[None]()

    def __enter__(self) -> Self:
        pool = ThreadPoolExecutor(1, "live diagnosis")
        self._run = pool.submit(lambda: asyncio.run(self._listen()))
        pool.shutdown(wait=False)
        self._run.add_done_callback(lambda _: self._is_begun.set())
        self._is_begun.wait()
        if self._run.done():
            self._run.result()
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        self._diagnosis.stop()
        if self._run.exception() is not None and error is None:
            self._run.result()

    @property
    def results(self) -> tuple[ShiftResult, ...]:
        """The shifts that were found until now."""
        return tuple(self._diagnosis.results)

    @property
    def controller_reports(self) -> tuple[ControllerNews, ...]:
        """What the controller said of its trouble codes until now, as ``LiveDiagnosis`` has it."""
        return tuple(self._diagnosis.controller_reports)

    @property
    def frames(self) -> FrameCounts:
        """What became of the frames until now."""
        return self._diagnosis.frames

    @property
    def analysis(self) -> Analysis:
        """All results and numbers until now."""
        return self._diagnosis.analysis

    def wait_for(self, shift_count: int, timeout_s: float) -> tuple[ShiftResult, ...]:
        """Return the shifts as soon as there are so many.

        Raises
        ------
        TimeoutError
            If there are fewer after this time; it says how many, and what became of the frames.
        SourceError, StoreError, ...
            What ended the diagnosis.
        """
        deadline_s = time.monotonic() + timeout_s
        while True:
            has_ended = self._run.done()  # asked first: what comes after that is seen by the next look
            if len(self._diagnosis.results) >= shift_count:
                return self.results
            if has_ended:
                self._run.result()
                raise TimeoutError(f"the diagnosis has ended with {self._progress}")
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"after {timeout_s:g} s {self._progress}, {shift_count} were waited for")
            time.sleep(POLL_S)

    def stop(self) -> Analysis:
        """End the diagnosis with what was received until now, and return all of it."""
        self._diagnosis.stop()
        self._run.result()
        return self.analysis

    @property
    def _progress(self) -> str:
        frames = self.frames
        return f"{len(self._diagnosis.results)} shifts, {frames.on_bus} frames, {frames.decoded} decoded"

    async def _listen(self) -> None:
        async with self._diagnosis:
            self._is_begun.set()
            async for _ in self._diagnosis:
                pass


class LiveDiagnosis:
    """A bus that is being diagnosed; made by ``diagnose``.

    Iterate over it with ``async for``, once; iteration ends after ``stop`` or ``duration_s``. Inside ``async with`` the
    bus is listened to from the beginning of the block on, and no longer at its end. Nothing happens before either.

    Attributes
    ----------
    results : list of ShiftResult
        What was found until now.
    controller_reports : list of ControllerNews
        What the controller said of its trouble codes, each time that it was something new; empty without ``poll``.
    left_out_count : int
        Results that were not handed over, since whoever iterates was too far behind; they are in ``results``.
    """

    def __init__(
        self,
        config: DiagnosisConfig,
        named: BusConfig,
        *,
        bus: "can.BusABC | None" = None,  # in place of the one that is named
        store: choices.AnyPath | None = None,
    ) -> None:
        self._config = config
        self._named = named
        self._bus = bus
        self._store_path = choices.optional_path(store)
        self._controls = Controls()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._task: asyncio.Task[None] | None = None
        self._waiting: asyncio.Queue[ShiftResult | None] = asyncio.Queue()
        self._source: LiveSource | None = None
        self._session: Session | None = None
        self._is_listening = asyncio.Event()
        self._is_iterated = False
        self._is_told = False
        self._summary: Summary | None = None
        self._notices: list[str] = []
        self.results: list[ShiftResult] = []
        self.controller_reports: list[ControllerNews] = []
        self.left_out_count = 0

    @property
    def description(self) -> str:
        """Interface and channel, for people; empty before it listens."""
        return "" if self._source is None else self._source.description

    @property
    def frames(self) -> FrameCounts:
        """What became of the frames until now."""
        if self._source is None or self._session is None:
            return FrameCounts()
        return frame_counts(self._source, self._session.stages)

    @property
    def analysis(self) -> Analysis:
        """All results and numbers; of a diagnosis that goes on, those until now."""
        summary = self._summary
        if summary is None and self._session is not None:
            summary = self._session.summary(self.frames, None)
        if summary is None:
            raise ConfigError("the diagnosis does not listen yet")
        return Analysis(
            paths=(),
            results=tuple(self.results),
            summary=summary_record(summary),
            notices=tuple(self._notices),
            calibration=self._config.calibration,
        )

    def stop(self) -> None:
        """End the diagnosis with what was received until now; any thread may call, a second call does nothing."""
        self._controls.stop.set()

    def in_background(self) -> "BackgroundDiagnosis":
        """Return the same for a program without an event loop: ``with diagnose(bus).in_background() as heard:``."""
        return BackgroundDiagnosis(self)

    async def __aenter__(self) -> Self:
        await self._start()
        return self

    async def __aexit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        await self._end(is_failing=error is not None)

    async def __aiter__(self) -> AsyncIterator[ShiftResult]:
        """Iterate over the shifts as they are found; raises what ``diagnose`` names."""
        if self._is_iterated:
            raise ConfigError("a live diagnosis can be iterated over only once; its results are in `results`")
        self._is_iterated = True
        await self._start()
        is_over = False
        try:
            while (result := await self._waiting.get()) is not None:
                yield result
            is_over = True
        finally:
            await self._end(is_failing=not is_over)

    async def _start(self) -> None:
        """Begin, unless that was done, and return when the bus is listened to; raises what prevents it."""
        if self._task is not None:
            return
        self._loop = asyncio.get_running_loop()
        self._task = asyncio.create_task(self._run(), name="live diagnosis")
        listening = asyncio.create_task(self._is_listening.wait(), name="listening")
        try:
            await asyncio.wait({self._task, listening}, return_when=asyncio.FIRST_COMPLETED)
        except asyncio.CancelledError:
            await self._end(is_failing=True)  # nobody else will
            raise
        finally:
            listening.cancel()
        if self._task.done():
            self._task.result()

    async def _end(self, *, is_failing: bool) -> None:
        """Stop and wait until all is stored; what went wrong is raised unless something else is on its way."""
        self._controls.stop.set()
        if self._task is not None:
            await asyncio.wait({self._task})
            if not (is_failing or self._is_told):
                self._is_told = True  # once, wherever it is waited for first
                self._task.result()

    async def _run(self) -> None:
        try:
            opened = asyncio.to_thread(ResultStore.open, self._store_path, self._config.budget_bytes)
            with collected_notices() as self._notices, closing(await opened) as store:
                await self._diagnose(store)
        finally:
            # Behind the results that were handed over and are on their way.
            asyncio.get_running_loop().call_soon(self._waiting.put_nowait, None)

    async def _diagnose(self, store: ResultStore) -> None:
        reporter = _Handing(self._hand_over, self.controller_reports.append)
        self._session = session = await asyncio.to_thread(
            lambda: Session(self._config, self._config.interpretation().decoder(), store, None, reporter)
        )
        self._source, schedule, named = await self._open_bus(session)
        self._summary = await diagnose_source(
            self._source, schedule, self._config, named, store, session, self._controls, self._is_listening.set
        )

    async def _open_bus(self, session: Session) -> tuple[LiveSource, ReadSchedule, BusConfig]:
        if self._bus is None:
            return await open_live(self._named, session)
        from canlog.live.pythoncan import PythonCanSource  # noqa: PLC0415 - SocketCAN does without python-can

        named, description = self._named, str(self._bus.channel_info)
        source = PythonCanSource(self._bus, description, is_owner=False, duration_s=named.duration_s)
        return source, ReadSchedule(), replace(named, duration_s=None) if source.has_own_time else named

    def _hand_over(self, result: ShiftResult) -> None:
        """Take a result in the thread that found it."""
        self.results.append(result)
        if self._loop is not None:
            with suppress(RuntimeError):  # the loop is gone: nobody iterates any more
                self._loop.call_soon_threadsafe(self._offer, result)

    def _offer(self, result: ShiftResult) -> None:
        if self._waiting.qsize() < MAX_WAITING:
            self._waiting.put_nowait(result)
        else:
            self.left_out_count += 1


class _Handing:
    """Hands over what a run reports."""

    def __init__(self, use: Callable[[ShiftResult], None], note: Callable[[ControllerNews], None]) -> None:
        self._use = use
        self._note = note

    def report(self, news: News) -> None:
        """Hand over a result or what a controller says; all else can be asked for."""
        if isinstance(news, ShiftResult):
            self._use(news)
        elif isinstance(news, ControllerNews):
            self._note(news)


def diagnose(
    bus: "can.BusABC | None" = None,
    *,
    interface: str | None = None,
    channel: str | None = None,
    bitrate: int | None = None,
    is_fd: bool = False,
    is_only_mapped: bool = False,
    duration_s: float | None = None,
    is_once: bool = False,
    store: choices.AnyPath | None = None,
    store_budget_mib: int | None = None,
    delivery: choices.Delivery | None = None,
    poll: choices.Poll | None = None,
    asks: bool = False,
    adapter: str | None = None,
    **meaning: Unpack[choices.FrameMeaning],
) -> LiveDiagnosis:
    """Diagnose a live bus, as ``diag-service run`` does.

    Parameters
    ----------
    bus
        An open bus of python-can, which is read from now on and not closed; or name one by the next arguments.
    interface, channel, bitrate, is_fd
        As python-can names them; what is not given comes from its environment variables and ``can.conf``. A bus that
        was named is opened again whenever it was away.
    is_only_mapped
        Whether the kernel discards, uncounted, all messages that are not needed.
    duration_s
        When to stop [s], in the time of a bus that has its own, as a simulation has.
    is_once
        Whether the diagnosis ends with the bus that was named, as with a simulation that ends.
    store
        SQLite file for results and running state; without one they are kept in memory.
    vehicle, dbc, profile, calibration, store_budget_mib, delivery
        As of ``analyze``.
    poll
        Whether the controller is asked for its trouble codes, and how often.
    asks
        Whether signals are asked for that the profile says are to be; needs a bus that was named. Without this and
        ``poll`` nothing is sent.
    adapter
        Through which they are asked for in place of a bus: ``elm327://HOST[:PORT]``, ``elm327:/dev/NAME`` or
        ``doip://HOST[:PORT]/ADDRESS``.

    Returns
    -------
    LiveDiagnosis
        To be iterated over with ``async for``; or ``.in_background()``.

    Raises
    ------
    ConfigError, CalibrationError
        If an argument cannot be used.
    SourceError, DefinitionError, StoreError
        While iterating: if the bus cannot be opened or, when it was handed over open, fails; a database or the store
        cannot be used.
    """
    choices.check_one_bus(bus, interface, channel, bitrate, is_fd, is_only_mapped, adapter)
    if bus is not None and poll is not None and poll.bus is None:
        raise ConfigError("an open bus has only one reader: give Poll(bus=...) a connection of its own")
    if bus is not None and asks:
        raise ConfigError("an open bus has only one reader: name the bus, which is opened once more to ask on it")
    options = LiveOptions(
        interface=interface, channel=channel, bitrate=bitrate, fd=is_fd, duration=duration_s, once=is_once,
        active=asks, adapter=adapter, only_mapped=is_only_mapped, store_budget=store_budget_mib,
        **choices.sent_to(delivery), **choices.named(meaning),
    )  # fmt: skip
    bus_named = replace(bus_config(options), poll=choices.poll_config(poll))
    return LiveDiagnosis(diagnosis_config(options), bus_named, bus=bus, store=store)


def run(
    options: LiveOptions,
    controls: Controls,
    reporter: Reporter,
    onlooker: Callable[[Snapshot], None] | None = None,
) -> None:
    """Diagnose a live bus until it is told to stop: ``diag-service run``.

    ``onlooker`` sees how it stands, again and again; then nothing is stored: ``diag-service monitor``.
    """
    config, bus = diagnosis_config(options), bus_config(options)
    path = None if onlooker is not None else options.store or default_store(config.vehicle)
    decoder = config.interpretation().decoder()
    with opened_store(config, path, keeps_results=True) as store:
        session = Session(config, decoder, store, None, reporter, kept_events=KeptEvents.beside(path))
        asyncio.run(serve_bus(config, bus, store, session, controls, onlooker))


def checked(options: LiveOptions) -> DiagnosisConfig:
    """Return what a run would diagnose by; raises what prevents it, but for bus, store and broker."""
    config = diagnosis_config(options)
    bus_config(options)
    config.interpretation()
    return config
