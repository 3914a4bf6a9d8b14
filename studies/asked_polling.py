"""What asking for signals costs: processor time of the thread that asks, and memory after a day of it.

The emulated controller answers at once on a virtual bus, so the pace is what a twentieth of 500 kbit/s allows; five
data are one by service 2C. It is measured alone, and beside broadcast frames that the bus filters in software, as
adapters without filters of their own do. The day is one of bus time: as many requests through the asker as the day has
at that pace, and all their frames, stamped as they would be, through the decoder, without any wait.

    python -m studies.asked_polling --seconds 30 --hours 24
"""

import argparse
import secrets
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final

import can
import psutil
from rich.console import Console

from canlog.frames import FrameBatch
from diag_service.mapping.asked_signals import DEFINE_DATA, POSITIVE, sizes_of
from diag_service.mapping.interpretation import interpret
from diag_service.mapping.profile import AskingRules, load_shipped
from diag_service.tester.addresses import CanAddress
from diag_service.tester.signal_asking import SignalAsker, address_of, line_on
from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.link import DiagnosticLink
from ecu_emulator.diagnostics.table_file import table_like
from tests.support.asked import Wire

PROFILE: Final = load_shipped("dct_asked")
RULES: Final = AskingRules(together=8, define=True)
SETS_PER_S: Final = 50
BROADCAST_PER_S: Final = 1000
DEFINED: Final = b"\xf3\x00"
LOOKS: Final = 4  # at memory
NS_PER_S: Final = 1_000_000_000
MIB: Final = 2**20


def processor_share(seconds: float, *, is_busy: bool) -> tuple[float, float]:
    """Return the share of a core that the asking thread takes, and sets a second."""
    values = {"engine_torque_nm": 120.0, "clutch1_pressure_pa": 4e5, "sump_temperature_k": 353.15}
    car = Controller(table_like("vw_dsg"), values=lambda: values, clock=time.monotonic, chance=secrets.token_bytes)
    addresses = [address_of(one) for one in PROFILE.asked.values()]
    with (
        can.Bus("polling", "virtual") as near,
        can.Bus("polling", "virtual") as bus,
        DiagnosticLink(car, near.send) as link,
        can.Notifier(near, [link.feed], timeout=0.05),
        broadcasting("polling", is_busy=is_busy),
    ):
        asker = SignalAsker(PROFILE.asked, RULES, lambda: line_on(bus, addresses, is_fd=False, listen_s=0.1))
        with asker:
            while asker.set_count < 1:
                time.sleep(0.05)
            (thread,) = [one for one in threading.enumerate() if one.name == "signal asker"]
            clock = time.pthread_getcpuclockid(thread.ident or 0)
            begun_s, spent_s, count = time.monotonic(), time.clock_gettime(clock), asker.set_count
            time.sleep(seconds)
            passed_s = time.monotonic() - begun_s
            return (time.clock_gettime(clock) - spent_s) / passed_s, (asker.set_count - count) / passed_s


@contextmanager
def broadcasting(channel: str, *, is_busy: bool) -> Iterator[None]:
    """Say what nobody asked for while the block runs."""
    over = threading.Event()

    def say() -> None:
        with can.Bus(channel, "virtual") as bus:
            while is_busy and not over.wait(0.01):
                for number in range(BROADCAST_PER_S // 100):
                    bus.send(can.Message(arbitration_id=0x100 + number, is_extended_id=False, data=bytes(8)))

    thread = threading.Thread(target=say)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


class AtOnce:
    """A way to a controller that answers with what is asked for, and ends after so many requests."""

    def __init__(self, count: int) -> None:
        self.left = count
        self.looks: list[int] = []
        self._every = max(1, count // LOOKS)
        self._sizes = sizes_of(PROFILE.asked.values())
        self._numbers = {one.number.to_bytes(2): size for one, size in self._sizes.items()}
        self.is_over = threading.Event()

    def ask(self, request: bytes, address: CanAddress) -> bytes:
        """Return the answer to a request."""
        del address
        self.left -= 1
        if self.left % self._every == 0:
            self.looks.append(resident())
        if self.left <= 0:
            self.is_over.set()
        if request[0] == DEFINE_DATA:
            return bytes([DEFINE_DATA + POSITIVE]) + request[1:4]
        numbers = [request[at : at + 2] for at in range(1, len(request), 2)]
        data = b"".join(one + bytes(10 if one == DEFINED else self._numbers[one]) for one in numbers)
        return bytes([request[0] + POSITIVE]) + data


def asker_memory(hours: float) -> list[int]:
    """Return the resident memory [byte] at equal distances through the requests of a drive."""

    @contextmanager
    def opened() -> Iterator[AtOnce]:
        yield line

    line = AtOnce(round(hours * 3600 * SETS_PER_S))
    with SignalAsker(PROFILE.asked, RULES, opened, bitrate=10**15):
        line.is_over.wait()
    return line.looks


def decoder_memory(hours: float) -> list[int]:
    """Return the resident memory [byte] at equal distances through the frames of a drive that was asked."""
    decoder = interpret(None, Path(PROFILE.name)).decoder()
    minute, minutes = minute_of_dialogue(), round(hours * 60)
    looks = []
    for number in range(minutes):
        for _ in decoder.feed(replace(minute, t_ns=minute.t_ns + number * 60 * NS_PER_S)):
            pass
        if number % max(1, minutes // LOOKS) == 0:
            looks.append(resident())
    return [*looks, resident()]


def minute_of_dialogue() -> FrameBatch:
    """Return the frames of a minute in which data are asked for fifty times a second."""
    wire = Wire(t_ns=NS_PER_S)
    numbers = [one.number for one in dict.fromkeys(one.data_id for one in PROFILE.asked.values())]
    request = b"\x22" + b"".join(one.to_bytes(2) for one in numbers)
    answer = b"\x62" + b"".join(one.to_bytes(2) + b"\x01\x90" for one in numbers)
    for number in range(60 * SETS_PER_S):
        wire.t_ns = NS_PER_S + number * NS_PER_S // SETS_PER_S
        wire.say(request, 0x7E1, 0x7E9)
        wire.t_ns += 5_000_000
        wire.say(answer, 0x7E9, 0x7E1)
    return wire.batch


def resident() -> int:
    """Return the memory of this process [byte]."""
    return int(psutil.Process().memory_info().rss)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0, help="for processor time")
    parser.add_argument("--hours", type=float, default=24.0, help="of bus time, for memory")
    options = parser.parse_args()
    console = Console(width=120)
    for is_busy in (False, True):
        share, sets_per_s = processor_share(options.seconds, is_busy=is_busy)
        beside = f"beside {BROADCAST_PER_S} broadcast frames a second" if is_busy else "alone"
        scaled = 100.0 * share * SETS_PER_S / sets_per_s
        console.print(
            f"{sets_per_s:.1f} sets/s {beside}: {100 * share:.2f} % of a core, {scaled:.2f} % at {SETS_PER_S}"
        )
    for name, looks in (("asker", asker_memory(options.hours)), ("decoder", decoder_memory(options.hours))):
        told = ", ".join(f"{one / MIB:.1f}" for one in looks)
        console.print(f"{name}, {options.hours:g} h at {SETS_PER_S} sets/s: {told} MiB resident on the way")


if __name__ == "__main__":
    main()
