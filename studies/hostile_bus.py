"""The live service on a bus on which others do what they want: emulator, service and attacker as programs.

Half of the time the bus is attacked, a minute each, by every attack in turn: 300 frames a second of no known message;
random frames; a second sender that plays 4,000 frames of the emulator again at four times their speed; error frames.
What happens in the other half must be diagnosed as if nothing had been. ``--beside foreign`` lets one attack go on all
the time instead, ``--beside nothing`` none: as many shifts must be valid.

    python -m studies.hostile_bus --minutes 20
    python -m tests.uml.run -- python -m studies.hostile_bus -i socketcan -c vcan0 --minutes 20
    python -m studies.hostile_bus --beside foreign --minutes 2
    python -m studies.hostile_bus -i virtual --beside foreign --minutes 2
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path
from typing import Final, NamedTuple, Protocol, Self

import can
import numpy as np
import psutil

import diag_service
from diag_service.api.live import BackgroundDiagnosis
from ecu_emulator import Emulator
from studies.run import parsed, study_parser

ATTACK_S, CALM_S = 60.0, 60.0
BEFORE_S, AFTER_S = (
    0.7,
    3.0,
)  # of an event is read before it begins; a message is believed again so long after an attack
REPLAYED: Final = 4_000
SPEED: Final = 4.0
FOREIGN_ID: Final = 0x3E9
READY: Final = "listening"
STOP_S: Final = 60.0
MOST_GROWTH_MB: Final = 10.0  # from the end of the first quarter on,
LONG_MINUTES: Final = 10.0  # of a run that is long enough to tell: caches fill for some minutes
MB: Final = 1e6
MEASURE_EVERY_S: Final = 5.0
SCENARIO: Final = "noise_only"
CYCLES: Final = 500  # more than any run has time for
Window = tuple[float, float, str]  # when the bus was attacked, and how [s since 1970]


@dataclass(slots=True)
class Attacker:
    """Another end of the bus."""

    bus: can.BusABC
    rng: np.random.Generator
    stop: threading.Event
    sent: Counter[str] = field(default_factory=Counter[str])

    def foreign(self, end_s: float) -> None:
        """Send frames of a message that nobody follows."""
        self._every(1.0 / 300.0, end_s, "foreign", lambda: _frame(FOREIGN_ID, self.rng.bytes(8)))

    def random(self, end_s: float) -> None:
        """Send any frames, those of followed messages among them."""

        def frame() -> can.Message:
            is_extended = self.rng.random() < 0.3
            can_id = int(self.rng.integers(2**29 if is_extended else 2**11))
            if self.rng.random() < 0.5:
                is_extended, can_id = False, int(self.rng.integers(0xA0, 0xD8))
            return _frame(can_id, self.rng.bytes(int(self.rng.integers(9))), is_extended_id=is_extended)

        self._every(1.0 / 500.0, end_s, "random", frame)

    def replay(self, end_s: float) -> None:
        """Play some seconds of the bus again, four times as fast, again and again."""
        while self.bus.recv(0.0) is not None:
            pass  # what has gathered since the last time
        heard = [message for _ in range(REPLAYED) if (message := self.bus.recv(5.0)) is not None]
        while time.time() < end_s and heard and not self.stop.is_set():
            began_s = time.time()
            for message in heard:
                due_s = began_s + (message.timestamp - heard[0].timestamp) / SPEED
                if due_s > end_s or self.stop.is_set():
                    return
                time.sleep(max(0.0, due_s - time.time()))
                self._send(_frame(message.arbitration_id, bytes(message.data)), "replayed")

    def errors(self, end_s: float) -> None:
        """Send error frames as fast as a bus has them."""
        self._every(
            1.0 / 2_000.0, end_s, "errors",
            lambda: _frame(int(self.rng.choice((0x04, 0x08, 0x20, 0x80))), self.rng.bytes(8), is_error_frame=True),
        )  # fmt: skip

    def nothing(self, end_s: float) -> None:
        """Let the bus be."""
        self.stop.wait(max(0.0, end_s - time.time()))

    def _every(self, period_s: float, end_s: float, name: str, frame: Callable[[], can.Message]) -> None:
        due_s = time.time()
        while due_s < end_s and not self.stop.is_set():
            time.sleep(max(0.0, due_s - time.time()))
            self._send(frame(), name)
            due_s += period_s

    def _send(self, message: can.Message, name: str) -> None:
        try:
            self.bus.send(message)
        except can.CanOperationError:  # no room for the moment
            time.sleep(0.01)
        else:
            self.sent[name] += 1


def _frame(can_id: int, data: bytes, **kind: bool) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, **({"is_extended_id": False} | kind))


ATTACKS: Final[Mapping[str, Callable[[Attacker, float], None]]] = {
    "foreign": Attacker.foreign,
    "random": Attacker.random,
    "replay": Attacker.replay,
    "errors": Attacker.errors,
    "nothing": Attacker.nothing,
}


class Shift(NamedTuple):
    """What is looked at of a result."""

    start_ns: int
    end_ns: int
    status: str
    reasons: tuple[str, ...]


class Bench(Protocol):
    """Emulator and service on one bus."""

    shifts: list[Shift]  # until now
    said: list[str]
    process_id: int  # of the service

    @property
    def is_alive(self) -> bool:
        """Whether the service is at work."""

    def stop(self) -> None:
        """End the service, which reports what is open."""


class Programs:
    """Both as programs of their own."""

    def __init__(self, running: "subprocess.Popen[str]") -> None:
        self.shifts: list[Shift] = []
        self.said: list[str] = []
        self.process_id, self._running = running.pid, running
        readers = [(running.stdout, self._take_record), (running.stderr, self.said.append)]
        self._threads = [threading.Thread(target=_read, args=reader, daemon=True) for reader in readers]
        for thread in self._threads:
            thread.start()

    @classmethod
    @contextmanager
    def started(cls, bus: Mapping[str, str], folder: Path, seed: int) -> Iterator[Self]:
        """Start the service, then the emulator."""
        where = ("-i", bus["interface"], "-c", bus["channel"])
        drive = ("--scenario", SCENARIO, "--cycles", str(CYCLES), "--seed", str(seed))
        with program("diag_service", "run", *where, "--store", str(folder / "car.sqlite"), "--json") as running:
            bench = cls(running)
            while not any(READY in line for line in bench.said):
                if not bench.is_alive:
                    raise SystemExit("".join(bench.said))
                time.sleep(0.1)
            with program("ecu_emulator", "run", *where, *drive, output=subprocess.DEVNULL):
                yield bench

    @property
    def is_alive(self) -> bool:
        return self._running.poll() is None

    def stop(self) -> None:
        self._running.send_signal(signal.SIGINT)
        self._running.wait(STOP_S)
        for thread in self._threads:
            thread.join()

    def _take_record(self, line: str) -> None:
        record = json.loads(line)
        if record["schema"].startswith("clutchdiag/shift/"):
            when_ns = record["start_bus_ns"], record["end_bus_ns"]
            self.shifts.append(Shift(*when_ns, record["status"], tuple(record["reasons"])))


def _read(stream: Iterator[str], take: Callable[[str], object]) -> None:
    for line in stream:
        take(line)


@contextmanager
def program(*words: str, output: int = subprocess.PIPE) -> Iterator["subprocess.Popen[str]"]:
    """Run one of our programs; it is ended at the end."""
    process = subprocess.Popen([sys.executable, "-m", *words], stdout=output, stderr=output, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


class ThisProcess:
    """Both in this process, on a ``virtual`` bus."""

    process_id = os.getpid()
    is_alive = True

    def __init__(self, heard: BackgroundDiagnosis) -> None:
        self.shifts: list[Shift] = []
        self.said: list[str] = []
        self._heard = heard

    @classmethod
    @contextmanager
    def started(cls, bus: Mapping[str, str], _folder: Path, seed: int) -> Iterator[Self]:
        """Start the emulator, then the service."""
        with (
            Emulator(SCENARIO, seed=seed, cycles=CYCLES, channel=bus["channel"]) as car,
            car.open_bus() as end,
            diag_service.diagnose(end).in_background() as heard,
        ):
            yield cls(heard)

    def stop(self) -> None:
        analysis = self._heard.stop()
        estimates = [result.estimate for result in analysis.results]
        self.shifts = [Shift(e.start_ns, e.end_ns, e.status, e.reasons) for e in estimates]
        self.said = [f"{analysis.frames}\n"]


BENCHES: Final[Mapping[str, Callable[[Mapping[str, str], Path, int], AbstractContextManager[Bench]]]] = {
    "virtual": ThisProcess.started
}


def attack(attacker: Attacker, beside: str, names: Sequence[str], end_s: float) -> list[Window]:
    """Attack the bus until then; return when it was attacked, and how [s since 1970]."""
    windows: list[Window] = []
    if beside:
        ATTACKS[beside](attacker, end_s)
        return windows
    for name in cycle(names):
        attacker.nothing(min(time.time() + CALM_S, end_s))
        if time.time() >= end_s or attacker.stop.is_set():
            return windows
        began_s = time.time()
        ATTACKS[name](attacker, min(began_s + ATTACK_S, end_s))
        windows.append((began_s, time.time(), name))
    raise AssertionError


def is_calm(shift: Shift, windows: list[Window]) -> bool:
    """Return whether nothing was attacked near a shift."""
    begin_s, end_s = shift.start_ns / 1e9 - BEFORE_S, shift.end_ns / 1e9 + BEFORE_S
    return all(end_s < began_s or begin_s > ended_s + AFTER_S for began_s, ended_s, _ in windows)


def main() -> int:
    """Print what became of all shifts; return 1 if one in calm was lost, or the service died or grew."""
    parser = study_parser(__doc__, seed=93, is_parallel=False)
    parser.add_argument("-i", "--interface", default="udp_multicast")
    parser.add_argument("-c", "--channel", default="239.74.93.1")
    parser.add_argument("--minutes", type=float, default=20.0)
    attacks = [name for name in ATTACKS if name != "nothing"]
    parser.add_argument("--attacks", nargs="+", choices=attacks, default=attacks, help="in turn (all)")
    parser.add_argument("--beside", choices=tuple(ATTACKS), default="", help="one attack, all the time")
    options = parsed(parser, minutes=1.5, beside="foreign")
    place = {"interface": options.interface, "channel": options.channel}
    windows: list[Window] = []
    memory_mb: list[float] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        BENCHES.get(options.interface, Programs.started)(place, Path(folder), options.seed) as bench,
        can.Bus(**place) as bus,
    ):
        attacker = Attacker(bus, np.random.default_rng(options.seed), threading.Event())
        end_s = time.time() + 60.0 * options.minutes
        attacking = threading.Thread(
            target=lambda: windows.extend(attack(attacker, options.beside, options.attacks, end_s))
        )
        attacking.start()
        while time.time() < end_s and bench.is_alive:
            memory_mb.append(psutil.Process(bench.process_id).memory_info().rss / MB)
            time.sleep(MEASURE_EVERY_S)
        is_alive = bench.is_alive
        attacker.stop.set()
        attacking.join()
        if is_alive:
            bench.stop()
    most_growth_mb = MOST_GROWTH_MB if options.minutes >= LONG_MINUTES else np.inf
    return report(bench, windows, attacker.sent, memory_mb, most_growth_mb, is_alive=is_alive)


def report(
    bench: Bench,
    windows: list[Window],
    sent: Counter[str],
    memory_mb: list[float],
    most_growth_mb: float,
    *,
    is_alive: bool,
) -> int:
    """Print the numbers; return the status."""
    calm = [shift for shift in bench.shifts if is_calm(shift, windows)][:-1]  # the end of the run cut the last one off
    valid = [shift for shift in calm if shift.status == "valid"]
    why = Counter(reason for shift in calm if shift.status != "valid" for reason in shift.reasons)
    faults = sum("internal_error" in shift.reasons for shift in bench.shifts)
    quarter = max(len(memory_mb) // 4, 1)
    growth_mb = max(memory_mb[quarter:], default=0.0) - max(memory_mb[:quarter])
    print(f"sent besides: {dict(sent) or 'nothing'}, in {len(windows)} attacks of {ATTACK_S:g} s")
    print(f"{len(bench.shifts)} events, {faults} of them internal_error")
    print(f"undisturbed: {len(calm)} events, {len(valid)} of them valid {dict(why) or ''}")
    print(
        f"memory: {memory_mb[0]:.0f} MB at first, {memory_mb[-1]:.0f} MB at last; {growth_mb:+.1f} MB since a quarter"
    )
    print(f"the service {'lived to the end' if is_alive else 'died'}; it said at last:")
    print("".join(f"  {line}" for line in bench.said[-3:]), end="")
    return int(not is_alive or bool(faults) or len(valid) < len(calm) or growth_mb > most_growth_mb)


if __name__ == "__main__":
    sys.exit(main())
