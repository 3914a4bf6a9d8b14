"""What the speed benchmarks measure with: processor time, peak memory, and the name of the machine."""

import os
import platform
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

LEAST_S: Final = 1e-4  # about the resolution of processor times


def processor_s() -> float:
    """Return the time that this process and its ended children have had [s]."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime


def took_s(work: Callable[[], object]) -> float:
    """Return how long some work keeps a processor busy [s]; what else the machine does counts little."""
    began_s = processor_s()
    work()
    return max(processor_s() - began_s, LEAST_S)


def peak_mib() -> float:
    """Return the largest memory this program has had [MiB]; ``ru_maxrss`` would count that of the one before it."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) / 1024


def machine() -> str:
    """Return what this ran on."""
    lines = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").splitlines()
    models = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return f"{next(models, platform.machine())}, {os.cpu_count()} cores, Python {platform.python_version()}"
