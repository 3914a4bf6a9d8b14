"""What all studies share: their options, work on several processes with progress, processor time and memory."""

import os
import pickle
import platform
import resource
import sys
import time
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

CaseT = TypeVar("CaseT", bound=Hashable)
ResultT = TypeVar("ResultT")

REPORT_EVERY: Final = 20  # cases
LEAST_S: Final = 1e-4  # about the resolution of processor times


def study_parser(doc: str | None, *, seed: int | None = None, is_parallel: bool = True) -> ArgumentParser:
    """Return a parser with what every study takes; ``seed`` is that of its first vehicle, drive or life."""
    parser = ArgumentParser(description=doc, formatter_class=RawDescriptionHelpFormatter)
    if seed is not None:
        parser.add_argument("--seed", "--first-seed", type=int, default=seed, help="the first one (%(default)s)")
    if is_parallel:
        parser.add_argument("--workers", "--jobs", type=int, default=2, help="processes (%(default)s)")
        parser.add_argument("--kept", type=Path, metavar="FILE", help="of results, with which an ended study goes on")
    return parser


def parsed(parser: ArgumentParser, argv: Sequence[str] | None = None, **short: object) -> Namespace:
    """Return the options; with ``--short`` what is not named is that of a run of two minutes on one core."""
    shown = " ".join(f"{name}={value}" for name, value in short.items()).replace("%", "%%")
    parser.add_argument("--short", action="store_true", help=f"ends within two minutes on one core: {shown}")
    options = parser.parse_args(argv)
    if options.short:
        parser.set_defaults(**({"workers": 1} if hasattr(options, "kept") else {}), **short)
        options = parser.parse_args(argv)
    return options


def over_drives(
    work: Callable[[CaseT], list[ResultT]], cases: Sequence[CaseT], workers: int, kept: Path | None = None
) -> list[ResultT]:
    """Return the results of all cases in their order, worked on by some processes; progress goes to stderr.

    With a file each result is added to it at once, and what it has already is not worked on again: a study of hours
    may be ended at any time. Such a file belongs to one state of the code and one set of options.
    """
    known: dict[CaseT, list[ResultT]] = {} if kept is None else read_kept(kept)
    left = [case for case in cases if case not in known]
    with ProcessPoolExecutor(workers) as pool:
        for number, (case, part) in enumerate(zip(left, pool.map(work, left), strict=True), start=1):
            known[case] = part
            if kept is not None:
                with kept.open("ab") as file:
                    pickle.dump((case, part), file)
            if number % REPORT_EVERY == 0 or number == len(left):
                print(f"{number} of {len(left)}", file=sys.stderr, flush=True)
    return [result for case in cases for result in known[case]]


def read_kept(kept: Path) -> dict[CaseT, list[ResultT]]:
    """Return the cases of a file with their results; a record that was being written at the end is cut off."""
    known = dict[CaseT, list[ResultT]]()
    with kept.open("a+b") as file:
        file.seek(0)
        try:
            while True:
                end = file.tell()
                case, part = pickle.load(file)  # noqa: S301 (a file of one's own)
                known[case] = part
        except (EOFError, pickle.UnpicklingError):
            file.truncate(end)
    return known


def percent(share: float) -> str:
    """Return a share 0..1 as whole percent."""
    return f"{100.0 * share:.0f}"


def root_mean_square(values: npt.NDArray[np.float64]) -> float:
    """Return the RMS of some values."""
    return float(np.sqrt(np.mean(np.square(values))))


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
