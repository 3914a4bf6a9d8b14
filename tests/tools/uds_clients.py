"""Asks an emulated car by every client that is not ours, each a process, and prints who can do what.

``python -m tests.uml.run -- python -m tests.tools.uds_clients`` on a real vcan, where isotpdump and tshark read along;
where there is no vcan0 on another bus, without those two. ``--write`` puts the table into docs/controller-tables.md.
Status 1: two clients were answered differently.
"""

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

from ecu_emulator.diagnostics.clutches import Adaptation
from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.memory import TestResult
from ecu_emulator.diagnostics.memory_file import MemoryFile
from ecu_emulator.diagnostics.pdx.package import pdx_package
from ecu_emulator.diagnostics.table_file import shipped_table
from tests.support.patience import HANG_S
from tests.support.ports import free_port
from tests.support.replay import free_bus
from tests.support.uds.clients_script import CLIENTS, LIST
from tests.uml.vcan import has_can_sockets, is_up

DOCUMENT: Final = Path(__file__).parents[2] / "docs/controller-tables.md"
TOO_HOT: Final = 0x27874B  # P2787, confirmed in one cycle
READERS: Final = ("isotpdump", "tshark")
SETTLED_S: Final = 8.0  # of an engine that runs, so that routine and status bits are as they stay
_VCAN: Final = "vcan0"
_MARK: Final = re.compile(r"(<!-- clients -->\n).*?(<!-- end -->)", re.DOTALL)
_SEED: Final = re.compile(r"^67 01 .*")
_OBD: Final = ("01", "02", "03", "04", "06", "07", "09")

Told = Mapping[str, tuple[str, str]]  # request and answer by the line of the list


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="the table into docs/controller-tables.md")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        told, read = asked(Path(folder))
    table = table_of(told, read)
    print(table)
    wrong = differences(told)
    print("\n".join(wrong) or f"{len(told)} clients were answered the same, to the byte, wherever they asked the same")
    if options.write and not wrong:
        text = DOCUMENT.read_text(encoding="utf-8")
        DOCUMENT.write_text(_MARK.sub(lambda found: f"{found[1]}{table}{found[2]}", text), encoding="utf-8")
    return int(bool(wrong))


def asked(folder: Path) -> tuple[dict[str, Told], dict[str, set[str]]]:
    """Return what each client was told, and the services that each reader of the bus has named."""
    is_real = has_can_sockets() and is_up(_VCAN)
    place = free_bus()
    interface, channel = ("socketcan", _VCAN) if is_real else ("udp_multicast", place.group)
    variables = {**os.environ, **({} if is_real else place.variables)}
    memory, pdx, log = folder / "tcu.json", folder / "tcu.pdx", folder / "bus.log"
    pdx.write_bytes(pdx_package(shipped_table()))
    _fail(memory)
    ports = {"--doip": free_port(), "--elm327": free_port()}
    words = ["-i", interface, "-c", channel, *(str(word) for pair in ports.items() for word in pair)]
    with ExitStack() as running:
        running.enter_context(_emulator([*words, "--diagnostic-memory", str(memory)], variables))
        dump = running.enter_context(_readers(channel, log)) if is_real else None
        time.sleep(SETTLED_S)
        told = {name: _client(name, [*words, "--pdx", str(pdx)], variables) for name in CLIENTS}
    read = {} if dump is None else {"isotpdump": _named_by_isotpdump(dump), "tshark": _named_by_tshark(log)}
    return told, read


def _fail(memory: Path) -> None:
    """Leave a memory with a confirmed code, and no adaptation: then clearing it changes no code for who comes next."""
    with MemoryFile(memory, shipped_table()) as store:
        controller = Controller(shipped_table(), values=dict, clock=lambda: 0.0, chance=bytes, store=store)
        controller.adapt(Adaptation())
        controller.report(TOO_HOT, TestResult.FAILED)


@contextmanager
def _emulator(words: Sequence[str], variables: Mapping[str, str]) -> Iterator[None]:
    """Run a car that stands in the workshop."""
    program = [sys.executable, "-m", "ecu_emulator", "run", "--diagnostics", "--workshop", *words]
    with subprocess.Popen(program, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=variables) as running:
        try:
            yield
        finally:
            running.send_signal(signal.SIGINT)
            _, complaint = running.communicate(timeout=HANG_S)
    if running.returncode:
        raise RuntimeError(complaint.decode())


def _client(name: str, words: Sequence[str], variables: Mapping[str, str]) -> Told:
    program = [sys.executable, "-m", "tests.support.uds.clients_script", name, *words]
    done = subprocess.run(program, check=False, capture_output=True, text=True, timeout=HANG_S, env=variables)
    if done.returncode:
        raise RuntimeError(f"{name}: {done.stderr}")
    return {line: (request, answer) for line, (request, answer) in json.loads(done.stdout).items()}


@contextmanager
def _readers(channel: str, log: Path) -> Iterator[list[str]]:
    """Let candump and isotpdump read along; the list has what isotpdump said, once they have ended."""
    said: list[str] = []
    ids = f"{channel},7E1:7FF,7E9:7FF"
    with (
        log.open("wb") as file,
        subprocess.Popen(["stdbuf", "-oL", "candump", "-L", ids], stdout=file) as dump,
        subprocess.Popen(
            ["stdbuf", "-oL", "isotpdump", "-s", "7E1", "-d", "7E9", "-u", channel], stdout=subprocess.PIPE, text=True
        ) as reader,
    ):
        try:
            yield said
        finally:
            for program in (dump, reader):
                program.terminate()
            said.append(reader.communicate(timeout=HANG_S)[0])


def _named_by_isotpdump(said: Iterable[str]) -> set[str]:
    """Return the services whose first frame isotpdump has shown: first byte of a single or first frame."""
    text = "\n".join(said)
    return {found.upper() for found in re.findall(r"\[(?:SF|FF)\] ln: \d+\s+data: ([0-9A-Fa-f]{2})", text)}


def _named_by_tshark(log: Path) -> set[str]:
    """Return the services that tshark has named, of requests and answers."""
    if not shutil.which("tshark"):
        return set()
    words = ["tshark", "-r", str(log), "-d", "can.subdissector,iso15765", "-d", "iso15765.subdissector,uds"]
    words += ["-Y", "uds", "-T", "fields", "-e", "uds.sid"]
    done = subprocess.run(words, check=True, capture_output=True, text=True, timeout=HANG_S)
    return {f"{int(one, 0):02X}" for line in done.stdout.splitlines() for one in line.split(",") if one}


def services() -> list[str]:
    """Return the services that are asked, in order: UDS, then OBD."""
    return [*dict.fromkeys(line[:2].upper() for line in LIST), *_OBD]


def table_of(told: Mapping[str, Told], read: Mapping[str, set[str]]) -> str:
    """Return the table: yes; no: asked, and not answered positively; -: no client of that, or nothing to read."""
    names = [*told, *(name for name in READERS if name in read)]
    rows = [["service", *names], ["---"] * (len(names) + 1)]
    for service in services():
        cells = [_cell(told[name], service) for name in told]
        rows.append([service, *cells, *("yes" if service in read[name] else "-" for name in names[len(told) :])])
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _cell(told: Told, service: str) -> str:
    answers = [answer for line, (_, answer) in told.items() if line[:2].upper() == service]
    if not answers:
        return "-"
    return "no" if any(not answer or answer.startswith("7f") for answer in answers) else "yes"


def differences(told: Mapping[str, Told]) -> list[str]:
    """Return where a client sent something else than the list says, or was answered unlike others; seeds are chance."""
    wrong = []
    answers: dict[str, dict[str, str]] = {}
    for name, one in told.items():
        for line, (request, answer) in one.items():
            if not request.startswith(line):
                wrong.append(f"{name} sent {request} for {line}")
            answers.setdefault(line, {})[name] = _SEED.sub("67 01 seed", answer)
    for line, by_name in answers.items():
        if len(set(by_name.values())) > 1:
            wrong.append(f"{line}: {by_name}")
    return wrong


if __name__ == "__main__":
    sys.exit(main())
