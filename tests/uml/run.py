"""Run a command where a vcan0 exists: on this kernel if it has one, else in User-Mode Linux.

``python -m tests.uml.run [--time-limit SECONDS] -- COMMAND...`` prints one line that names the kernel, streams the
command's output and exits with its status. Inside the guest the command sees the host's files, the same working
folder and environment, an own network with vcan0, and the rights of whoever started it.
"""

import argparse
import contextlib
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import Enum, auto
from pathlib import Path

from tests.uml.vcan import native_vcan

BOOT_LIMIT_S = 300.0  # a second and a half; only what hangs takes longer, whatever else the machine does
INIT = Path(__file__).with_name("init.sh")
PACKAGE = "user-mode-linux"
SESSION_NICE = "-10"
COMPILERS = "cc", "gcc", "tcc"
WIDE_REGISTERS = Path(__file__).with_name("wide_registers.c")
UNAVAILABLE = 69  # EX_UNAVAILABLE of sysexits.h
TIMED_OUT = 124  # as timeout(1)


class Ending(Enum):
    """What ended a guest."""

    DONE = auto()  # its job
    OUT_OF_TIME = auto()
    BROKEN = auto()  # it did not come up, or broke down


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command of the command line; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.uml.run", description="Run a command next to a vcan0.")
    parser.add_argument(
        "--time-limit",
        type=float,
        default=3600.0,
        metavar="SECONDS",
        help="of the command, once it can begin (default: 3600)",
    )
    parser.add_argument("--memory", type=memory_size, default="2G", help="of the guest, as 512M (default: 2G)")
    parser.add_argument("--force-uml", action="store_true", help="use User-Mode Linux even if this kernel has vcan")
    parser.add_argument("command", nargs="+", metavar="COMMAND")
    options = parser.parse_args(arguments)
    if not options.force_uml:
        with native_vcan() as is_ready:
            if is_ready:
                say(f"vcan: kernel {os.uname().release}, native")
                return run_native(options.command, options.time_limit)
    kernel = shutil.which("linux.uml") or install_kernel()
    if kernel is None:
        say(
            "vcan: this kernel has no vcan0 (modprobe vcan; ip link add vcan0 type vcan; ip link set vcan0 up)"
            f" and linux.uml is missing (apt-get install {PACKAGE})"
        )
        return UNAVAILABLE
    return run_guest(kernel, options.command, options.memory, options.time_limit)


def memory_size(text: str) -> str:
    """Check a size on the command line."""
    if not re.fullmatch(r"[1-9]\d*[MG]", text):
        raise argparse.ArgumentTypeError(f"not a size: {text!r} (512M, 2G)")
    return text


def say(line: str) -> None:
    """Print one line of our own, ahead of the command's output."""
    print(line, flush=True)


def install_kernel() -> str | None:
    """Install Debian's User-Mode Linux if we may; return the kernel's path or None."""
    if os.geteuid() != 0 or shutil.which("apt-get") is None:
        return None
    say(f"vcan: installing the package {PACKAGE}")
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    for step in (["apt-get", "-qq", "update"], ["apt-get", "-qq", "install", "-y", "--no-install-recommends", PACKAGE]):
        subprocess.run(step, env=environment, stdout=subprocess.DEVNULL, check=False)
    return shutil.which("linux.uml")


def run_native(command: Sequence[str], limit_s: float) -> int:
    """Run the command here and now, in a process group of its own that does not outlive this call."""
    process = subprocess.Popen(command, start_new_session=True)
    try:
        return process.wait(timeout=limit_s)
    except subprocess.TimeoutExpired:
        say("vcan: time limit reached, command ended")
        return TIMED_OUT
    finally:
        end_group(process)


def run_guest(kernel: str, command: Sequence[str], memory: str, limit_s: float) -> int:
    """Boot the guest, run the command in it, halt it; return the command's status."""
    with tempfile.TemporaryDirectory(prefix="uml-") as name:
        folder = Path(name)
        marker = f"@{uuid.uuid4().hex}"
        write_job(folder, command, marker)
        boot = [
            kernel, f"mem={memory}", "root=/dev/root", "rootfstype=hostfs", "rootflags=/", "rw", f"init={folder}/init",
            f"uml_dir={folder}/", "con=null", "con0=fd:0,fd:1", "quiet",
        ]  # fmt: skip
        with on_one_core():
            process = subprocess.Popen(
                boot,
                env=boot_environment(folder, memory) | wide_registers(folder),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        come_first(process.pid)
        try:
            ending = stream_output(process, marker, limit_s)
        finally:
            end_group(process)
        status = folder / "status"
        if status.exists() and ending is Ending.DONE:
            return int(status.read_text())
        if ending is Ending.OUT_OF_TIME:
            say("vcan: time limit reached, guest ended")
            return TIMED_OUT
        say("vcan: the User-Mode Linux guest did not come up or broke down")
        return UNAVAILABLE


@contextmanager
def on_one_core() -> Iterator[None]:
    """Keep processes that are started here to one core.

    The guest's processes hand over to each other by ptrace. Where two cores are idle each hand-over wakes the other
    one, which costs more than the work: the guest's tests took three times as long.
    """
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {sorted(allowed)[os.getpid() % len(allowed)]})
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def come_first(pid: int) -> None:
    """Let the guest's session come before others, where that is allowed: its tests drive in real time, the rest waits.

    The kernel shares a core between sessions first, so that a nice value says nothing to processes of another one.
    """
    with contextlib.suppress(OSError):  # another kernel, or without the right
        Path(f"/proc/{pid}/autogroup").write_text(SESSION_NICE, encoding="ascii")


def boot_environment(folder: Path, memory: str) -> dict[str, str]:
    """Return the kernel's environment: the file that is its memory goes where there is room for it."""
    size_bytes = int(memory[:-1]) * {"M": 2**20, "G": 2**30}[memory[-1]]
    shared = Path("/dev/shm")  # noqa: S108 - the host's own tmpfs, the fastest place
    has_room = shared.is_dir() and shutil.disk_usage(shared).free > size_bytes
    return {"PATH": os.environ.get("PATH", os.defpath), "TMPDIR": str(shared if has_room else folder)}


def wide_registers(folder: Path) -> dict[str, str]:
    """Return what lets the kernel start on a processor with tiles (AMX), whose registers are larger than it knows."""
    if "amx_tile" not in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace"):
        return {}
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        say("vcan: User-Mode Linux needs a C compiler on this processor (apt-get install tcc)")
        return {}
    library = folder / "wide_registers.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-nostdlib", "-o", library, WIDE_REGISTERS], check=True)
    return {"LD_PRELOAD": str(library)}


def write_job(folder: Path, command: Sequence[str], marker: str) -> None:
    """Write what the guest needs: its init, the marker, and a script with environment, folder and command."""
    exports = [f"export {key}={shlex.quote(value)}" for key, value in os.environ.items() if key.isidentifier()]
    path = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/sbin"]).strip(os.pathsep)
    script = [*exports, f"export PATH={shlex.quote(path)}", f"cd {shlex.quote(str(Path.cwd()))} || exit 125"]
    (folder / "job.sh").write_text("\n".join([*script, f"exec {shlex.join(command)}", ""]))
    (folder / "marker").write_text(marker)
    shutil.copy(INIT, folder / "init")
    (folder / "init").chmod(0o700)


def stream_output(process: subprocess.Popen[bytes], marker: str, limit_s: float) -> Ending:
    """Copy what the job prints until it ends or has had its time; the kernel's own messages only if the boot fails.

    Returns
    -------
    Ending
        Whether the guest came up, and what ended it.
    """
    if process.stdout is None:
        raise RuntimeError("the guest was started without a pipe")
    os.set_blocking(process.stdout.fileno(), False)
    begin, end = f"{marker} begin ".encode(), f"{marker} end".encode()
    pending, has_begun = b"", False
    started_s = time.monotonic()
    deadline_s = started_s + BOOT_LIMIT_S
    while time.monotonic() < deadline_s:
        data = process.stdout.read()
        if data == b"":
            has_begun = False  # it cannot go on
            break
        if data is None:
            time.sleep(0.02)
            continue
        pending += data
        if not has_begun and begin in pending and b"\n" in pending.split(begin, 1)[1]:
            release, pending = pending.split(begin, 1)[1].split(b"\n", 1)
            boot_s = time.monotonic() - started_s
            say(f"vcan: kernel {release.decode().strip()}, User-Mode Linux (booted in {boot_s:.1f} s)")
            has_begun = True
            deadline_s = time.monotonic() + limit_s
        if has_begun:
            job, mark, _ = pending.partition(end)
            # The start of an end marker may be cut by the read: hold that much back.
            ready = job if mark else job[: job.rfind(b"@")] if b"@" in job[-len(end) :] else job
            sys.stdout.buffer.write(ready)
            sys.stdout.buffer.flush()
            pending = pending[len(ready) :]
            if mark:
                process.stdout.read()
                process.wait(timeout=BOOT_LIMIT_S)
                return Ending.DONE
    sys.stdout.buffer.write(pending)
    sys.stdout.buffer.flush()
    return Ending.OUT_OF_TIME if has_begun else Ending.BROKEN


def end_group(process: subprocess.Popen[bytes]) -> None:
    """End whatever is left of the process and its children."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    if process.stdout is not None:
        process.stdout.close()


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    sys.exit(main())
