"""An hour of the service on a bus that misbehaves: memory, descriptors, unhandled exceptions, and what it found.

    python -m tests.tools.soak --minutes 60

The service is ``diag-service run`` as a process, with a store, metrics that somebody reads and, where Mosquitto is
installed, a broker. On its bus a drive goes on in real time among foreign traffic, ten frames for each one of its
own, and every few seconds something goes wrong (``tests.support.rough_bus``). Where this kernel has no vcan the whole
runs in User-Mode Linux. Every shift that was estimated is held against the truth.
"""

import argparse
import math
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import psutil

from tests.plugins.broker import Mosquitto
from tests.support.ports import free_port
from tests.support.rough_bus import RoughBus, is_guest
from tests.support.service import Ended, Service, service
from tests.uml.vcan import create_vcan, has_can_sockets, ip_link

RATE_RATIO: Final = 10.0
FAULT_PERIOD_S: Final = 5.0
SAMPLE_S: Final = 5.0
SETTLE_MINUTES: Final = 5.0
GROWTH_TARGET: Final = 0.05
CHANNEL: Final = "vcan70"
MB: Final = 1e6
UNHANDLED: Final = ("Traceback", "never retrieved", "never awaited", "Exception ignored", "Fatal Python error")
_BOOT_S: Final = 300.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """The service at one moment."""

    t_s: float
    rss_mb: float
    descriptors: int
    threads: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Soaked:
    """What an hour did to a service."""

    samples: tuple[Sample, ...]
    ended: Ended
    sent: int
    struck: Counter[str]
    truth_mu: dict[int, tuple[float, float]]  # by clutch
    behind_s: float
    settle_s: float

    @property
    def settled(self) -> list[Sample]:
        """What was seen once the service was warm."""
        return [sample for sample in self.samples if sample.t_s >= self.settle_s]

    @property
    def growth(self) -> float:
        """Largest growth of resident memory, against the first minute after settling."""
        sizes = [sample.rss_mb for sample in self.settled]
        return max(sizes) / float(np.median(sizes[: round(60.0 / SAMPLE_S)])) - 1.0

    @property
    def descriptor_counts(self) -> tuple[int, ...]:
        """The different numbers of open descriptors that were seen."""
        return tuple(sorted({sample.descriptors for sample in self.settled}))

    @property
    def unhandled(self) -> list[str]:
        """Lines of standard error that tell of an exception that nobody handled."""
        return [line for line in self.ended.err.splitlines() if any(sign in line for sign in UNHANDLED)]

    @property
    def is_balanced(self) -> bool:
        """Whether every frame that the kernel had for us has one fate."""
        frames = self.ended.summary["frames"]
        fates = ("decoded", "ignored", "unsupported", "kernel_dropped", "queue_dropped")
        return bool(frames["on_bus"] == sum(frames[fate] for fate in fates) + sum(frames["rejected"].values()))

    def errors_std(self) -> Iterator[float]:
        """Yield the error of every accepted estimate in its own standard deviations."""
        for shift in self.ended.shifts:
            if shift["friction"] is None:
                continue
            for name, truth in zip(("mu_c", "mu_s"), self.truth_mu[shift["clutch"]], strict=True):
                yield abs(shift["friction"][name] - truth) / shift["friction"][f"std_{name}"]


def soak(folder: Path, channel: str, minutes: float, settle_minutes: float, seed: int) -> Soaked:
    """Run the service on a rough bus; return what became of it."""
    with ExitStack() as stack:
        arguments = ["run", "-v", "-i", "socketcan", "-c", channel, "--json", "--vehicle", "soak"]
        port = free_port()
        arguments += ["--store", str(folder / "car.sqlite"), "--metrics", str(port)]
        if shutil.which("mosquitto", path="/usr/sbin:/usr/bin:/usr/local/sbin"):
            (folder / "broker").mkdir()
            broker = Mosquitto(folder / "broker")
            broker.start()
            stack.callback(broker.stop)
            arguments += ["--broker", broker.url]
        bus = RoughBus(channel, rate_ratio=RATE_RATIO, seed=seed, may_set_clock=is_guest())
        running = stack.enter_context(service(folder / "service", *arguments))
        running.wait_for(lambda: "listening" in running.err, _BOOT_S)
        with bus:
            samples = tuple(watch(running, bus, port, 60.0 * minutes))
        running.process.terminate()
        ended = running.wait(_BOOT_S)
        ip_link("delete", bus.channel)
    return Soaked(
        samples=samples,
        ended=ended,
        sent=bus.sent,
        struck=bus.struck,
        truth_mu=mean_truth(bus),
        behind_s=bus.late_s,
        settle_s=60.0 * settle_minutes,
    )


def watch(running: Service, bus: RoughBus, port: int, duration_s: float) -> Iterator[Sample]:
    """Let faults happen and yield how the service stands; print a line now and then."""
    process = psutil.Process(running.process.pid)
    began_s = time.monotonic()
    next_fault_s, next_sample_s, next_line_s = FAULT_PERIOD_S, SAMPLE_S, 0.0
    fault = ""
    while (now_s := time.monotonic() - began_s) < duration_s:
        if running.process.poll() is not None or not bus.is_sending:
            raise SystemExit(f"ended after {now_s:.0f} s and {dict(bus.struck)}, last {fault}: {running.err[-2000:]}")
        if now_s >= next_sample_s:
            sample = look(process, now_s)
            yield sample
            read_metrics(port)
            next_sample_s += SAMPLE_S
            if now_s >= next_line_s:
                tell(sample, bus)
                next_line_s = now_s + 60.0
        if now_s >= next_fault_s:
            fault = bus.strike()
            next_fault_s = max(next_fault_s + FAULT_PERIOD_S, time.monotonic() - began_s)
        time.sleep(0.1)


def look(process: psutil.Process, t_s: float) -> Sample:
    """Return how the service stands."""
    with process.oneshot():
        return Sample(
            t_s=t_s,
            rss_mb=process.memory_info().rss / MB,
            descriptors=process.num_fds(),
            threads=process.num_threads(),
        )


def read_metrics(port: int) -> None:
    """Read the metrics as Prometheus would."""
    with (
        suppress(urllib.error.URLError, TimeoutError),
        urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=5.0) as answer,
    ):
        answer.read()


def tell(sample: Sample, bus: RoughBus) -> None:
    """Print one line on how it goes."""
    print(
        f"{sample.t_s / 60.0:6.1f} min  {sample.rss_mb:7.1f} MB  {sample.descriptors} descriptors  "
        f"{sample.threads} threads  {bus.sent} sent  {sum(bus.struck.values())} faults  {len(bus.truth)} shifts driven",
        flush=True,
    )


def mean_truth(bus: RoughBus) -> dict[int, tuple[float, float]]:
    """Return the friction that was true, by clutch: of a vehicle that does not age."""
    return {
        clutch: (float(np.mean([one.mu_c for one in own])), float(np.mean([one.mu_s for one in own])))
        for clutch in (1, 2)
        if (own := [one for one in bus.truth if one.clutch == clutch])
    }


def report(soaked: Soaked) -> bool:
    """Print what came of it; return whether it is what was asked for."""
    ended = soaked.ended
    frames, minutes = ended.summary["frames"], soaked.samples[-1].t_s / 60.0
    settled = soaked.settled
    statuses = Counter(shift["status"] for shift in ended.shifts)
    errors = sorted(soaked.errors_std())
    rate_hz = soaked.sent / (60.0 * minutes)
    print(f"{minutes:.1f} minutes, {soaked.sent} frames sent ({rate_hz:.0f}/s), at most {soaked.behind_s:.1f} s late")
    print(
        f"faults       {sum(soaked.struck.values())}: {', '.join(f'{n} {k}' for k, n in sorted(soaked.struck.items()))}"
    )
    print(f"frames       {frames}")
    print(f"shifts       {dict(statuses)}")
    if errors:
        print(
            f"estimates    {len(errors)}, largest error {errors[-1]:.1f} std, "
            f"RMS {math.sqrt(np.mean(np.square(errors))):.2f} std"
        )
    checks = {
        f"memory grew {100 * soaked.growth:+.1f} % after settling, to {max(one.rss_mb for one in settled):.0f} MB": (
            soaked.growth < GROWTH_TARGET
        ),
        f"descriptors {soaked.descriptor_counts}, threads {sorted({one.threads for one in settled})}": (
            len(soaked.descriptor_counts) == 1
        ),
        f"unhandled exceptions {len(soaked.unhandled)}, exit status {ended.status}": (
            not soaked.unhandled and ended.status == 0
        ),
        "every received frame has one fate": soaked.is_balanced,
    }
    for text, is_met in checks.items():
        print(f"{'met' if is_met else 'MISSED':<12} {text}")
    for line in soaked.unhandled[:10]:
        print(f"  {line}")
    return all(checks.values())


def main() -> int:
    """Soak the service, in a guest if it must be."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="default: 60")
    parser.add_argument(
        "--settle", type=float, default=SETTLE_MINUTES, help="minutes that memory may grow (default: 5)"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="leave the service's outputs in this folder")
    options = parser.parse_args()
    if not has_can_sockets():
        limit_s = round(60.0 * options.minutes + 4 * _BOOT_S)
        guest = [sys.executable, "-m", "tests.uml.run", "--time-limit", str(limit_s), "--"]
        return subprocess.run([*guest, sys.executable, "-m", "tests.tools.soak", *sys.argv[1:]], check=False).returncode
    if not create_vcan(CHANNEL):
        raise SystemExit(f"cannot create {CHANNEL}")
    with tempfile.TemporaryDirectory() as name:
        folder = options.keep or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        soaked = soak(folder, CHANNEL, options.minutes, options.settle, options.seed)
    return 0 if report(soaked) else 1


if __name__ == "__main__":
    sys.exit(main())
