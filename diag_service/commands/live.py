"""``diag-service run``, ``monitor`` and ``config check``: a live bus is diagnosed or shown, or what a run would use."""

import asyncio
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Final
from urllib.parse import urlsplit

import tomli_w

from canlog.errors import SourceError
from canlog.live import BusOpener, LinkBreak, LiveSource, Silence, supervise
from clutchdiag_io.program import legible
from diag_service.commands.talks import Conversations, conversations_of
from diag_service.console import PeopleConsole
from diag_service.mapping.interpretation import asked_database
from diag_service.service import bus_run
from diag_service.service.live import close_in_time
from diag_service.service.stopping import Controls, Trigger
from diag_service.settings.config import BusConfig, bus_config, default_store, diagnosis_config
from diag_service.settings.options import SETTINGS

LOOK_PERIOD_S: Final = 0.25
NS_PER_S: Final = 1e9
Show = Callable[[str], object]


def run(options: SimpleNamespace, controls: Controls) -> None:
    """Diagnose the bus until it is told to stop."""
    diagnosis = diagnosis_config(options)
    bus = bus_config(options)
    store = options.store or default_store(diagnosis.vehicle)
    bus_run.run_bus(diagnosis, bus, store, controls, as_json=options.json, is_detailed=options.verbose > 0)


def monitor(options: SimpleNamespace, controls: Controls) -> None:
    """Show the bus, or what is said on it, until it is told to stop."""
    if options.conversations or options.pairs:
        talks = conversations_of(asked_database(options).messages, options.pairs or "")
        asyncio.run(_open_and_follow(bus_config(options), talks, controls.stop, PeopleConsole().print))
        return
    bus_run.run_monitor(diagnosis_config(options), bus_config(options), controls)


async def _open_and_follow(bus: BusConfig, talks: Conversations, stop: Trigger, show: Show) -> None:
    """Show the conversations of a bus until told to stop, or as long as was asked for; raises SourceError."""
    source = await supervise(BusOpener(bus.interface, bus.channel, bus.bitrate, fd=bus.is_fd))
    show(f"{source.description}: conversations as they come")
    await follow(source, talks, stop, show, bus.duration_s)


async def follow(
    source: LiveSource, talks: Conversations, stop: Trigger, show: Show, duration_s: float | None = None
) -> None:
    """Show the conversations of a source until it ends, and then what came of all of them; raises SourceError."""
    failure: SourceError | None = None
    heard = _Heard()

    async def look_again() -> None:
        while True:
            await asyncio.sleep(LOOK_PERIOD_S)
            _show_news(talks, heard.now_ns, show)

    async with asyncio.TaskGroup() as tasks:
        beside = [tasks.create_task(close_in_time(source, stop, duration_s)), tasks.create_task(look_again())]
        try:
            async for part in source:
                if isinstance(part, LinkBreak):
                    show(f"the bus was lost: {part.problem}")
                elif not isinstance(part, Silence) and len(part):
                    talks.add(part)
                    heard.at(int(part.t_ns[-1]))
                    _show_news(talks, heard.now_ns, show)
        except SourceError as exc:
            failure = exc
        for task in beside:
            task.cancel()
    await source.aclose()
    talks.close()
    for line in talks.lines():
        show(line)
    if failure is not None:
        raise failure


class _Heard:
    """The time on the bus, which goes on where nothing is sent."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._at_s = 0.0

    def at(self, last_ns: int) -> None:
        """Note the time of the last frame."""
        self._last_ns, self._at_s = last_ns, asyncio.get_running_loop().time()

    @property
    def now_ns(self) -> int | None:
        """The time on the bus; None before the first frame."""
        if self._last_ns is None:
            return None
        return self._last_ns + round((asyncio.get_running_loop().time() - self._at_s) * NS_PER_S)


def _show_news(talks: Conversations, now_ns: int | None, show: Show) -> None:
    for line in talks.news(now_ns) if now_ns is not None else ():
        show(line)


_LOG = logging.getLogger(__name__)


def config(options: SimpleNamespace, controls: Controls) -> None:
    del controls
    diagnosis = diagnosis_config(options)
    bus_config(options)
    diagnosis.interpretation()
    broker = diagnosis.broker
    if broker is not None and broker.exposure:
        _LOG.warning("%s", broker.exposure)
    sys.stdout.write(describe(options))


def describe(options: SimpleNamespace) -> str:
    """Return the options as the text of a settings file, with what is secret masked."""
    return "".join(_line(name, getattr(options, name)) for name in SETTINGS)


def _line(name: str, value: str | float | Path | None) -> str:
    if value is None:
        return f"# {name} is not set\n"
    if isinstance(value, str | Path):
        text = str(value)
        if name == "broker" and (password := urlsplit(text).password) is not None:
            text = text.replace(f":{password}@", ":***@")
        value = legible(text)
    return tomli_w.dumps({name: value})
