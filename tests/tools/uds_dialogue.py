"""Writes the dialogue of docs/controller-tables.md as scapy reads it: ``python -m tests.tools.uds_dialogue``.

``--readers`` prints how other programs read it instead: isotpdump, where there is a vcan0, and tshark, where it is
installed. In the guest: ``python -m tests.uml.run -- python -m tests.tools.uds_dialogue --readers``.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any, Final

from tests.support.patience import HANG_S
from tests.support.uds.dialogue import Dialogue, held_dialogue
from tests.uml.vcan import has_can_sockets, is_up

DOCUMENT: Final = Path(__file__).parents[2] / "docs/controller-tables.md"
MOST_BYTES: Final = 16  # shown of a message
_MARK: Final = re.compile(r"(<!-- dialogue -->\n).*?(<!-- end -->)", re.DOTALL)
_FRAME_KINDS: Final = ("SF", "FF", "CF", "FC")
_VCAN: Final = "vcan0"
_NEGATIVE: Final = 0x7F
_NO_RESPONSE_BIT: Final = 0xBF  # a service's number in request and response, as tshark shows it
_SHOWN: Final = ("uds.sid", "uds.err.sid", "uds.err.code")


def read_by_scapy(log: Path) -> list[dict[str, Any]]:
    """Return the messages that scapy finds in a log."""
    words = [sys.executable, "-m", "tests.support.uds.scapy_reader", str(log)]
    done = subprocess.run(words, check=True, capture_output=True, text=True, timeout=HANG_S)
    told: list[dict[str, Any]] = json.loads(done.stdout)
    return told


def written(text: str, told: list[dict[str, Any]]) -> str:
    """Return a document with the dialogue as it was read."""
    return _MARK.sub(lambda found: f"{found[1]}```text\n{_lines(told)}```\n{found[2]}", text)


def _lines(told: list[dict[str, Any]]) -> str:
    return "".join(f"{one['can_id']:03X}  {_shown(one['bytes']):<62}  {_meaning(one)}\n" for one in told)


def _shown(digits: str) -> str:
    data = bytes.fromhex(digits)
    more = f" ... {len(data)} bytes" if len(data) > MOST_BYTES else ""
    return data[:MOST_BYTES].hex(" ").upper() + more


def _meaning(one: dict[str, Any]) -> str:
    return f"{one['service']}: {one['refusal']}" if one["refusal"] else str(one["service"])


def kinds_of(dialogue: Dialogue) -> Counter[str]:
    """Return how many single, first, consecutive and flow control frames there are."""
    return Counter(_FRAME_KINDS[data[0] >> 4] for _, data in dialogue.frames)


def read_by_isotpdump(log: Path, channel: str) -> str:
    """Return what isotpdump prints while a log is played on a bus."""
    words = ["stdbuf", "-oL", "isotpdump", "-s", "7E1", "-d", "7E9", "-u", channel]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as dump:
        time.sleep(1.0)  # it does not say when it listens
        subprocess.run(["canplayer", "-I", str(log), f"{channel}=can0"], check=True, timeout=HANG_S)
        time.sleep(0.5)
        dump.terminate()
        return dump.communicate(timeout=HANG_S)[0]


def kinds_read(text: str) -> Counter[str]:
    """Return how many frames of each kind isotpdump has named."""
    return Counter(kind for kind in re.findall(r"\[(\w\w)\]", text) if kind in _FRAME_KINDS)


def read_by_tshark(log: Path, *more: str) -> str:
    """Return the lines that tshark prints of a log."""
    decoders = ["-d", "can.subdissector,iso15765", "-d", "iso15765.subdissector,uds"]
    words = ["tshark", "-r", str(log), *decoders, "-Y", "uds", *more]
    return subprocess.run(words, check=True, capture_output=True, text=True, timeout=HANG_S).stdout


def services_read(text: str) -> list[tuple[int, ...]]:
    """Return the service of each message that tshark has found; of a refusal also whose and why."""
    rows = [[column for column in line.split("\t") if column] for line in text.splitlines()]
    return [tuple(int(column, 0) for column in row) for row in rows]


def services_of(dialogue: Dialogue) -> list[tuple[int, ...]]:
    """Return the same of the messages that were exchanged."""
    return [(data[0] & _NO_RESPONSE_BIT, *(data[1:3] if data[0] == _NEGATIVE else ())) for _, data in dialogue.messages]


def show_tshark(dialogue: Dialogue, log: Path) -> None:
    """Print what tshark makes of the dialogue."""
    fields = [word for name in _SHOWN for word in ("-e", name)]
    read, said = services_read(read_by_tshark(log, "-T", "fields", *fields)), services_of(dialogue)
    same = sum(one == other for one, other in zip(read, said, strict=False))
    print(f"tshark: {len(read)} messages, service and refusal of {same} of {len(said)} the same")
    print(read_by_tshark(log))


def show_readers(dialogue: Dialogue, log: Path) -> None:
    """Print what each reader that is here makes of the dialogue."""
    told = read_by_scapy(log)
    same = sum(
        (one["can_id"], bytes.fromhex(one["bytes"])) == ours for one, ours in zip(told, dialogue.messages, strict=True)
    )
    print(f"scapy: {same} of {len(dialogue.messages)} messages the same")
    if has_can_sockets() and is_up(_VCAN):
        text = read_by_isotpdump(log, _VCAN)
        print(f"isotpdump: {dict(kinds_read(text))} frames of {dict(kinds_of(dialogue))}\n{text}")
    else:
        print(f"isotpdump: needs {_VCAN}")
    if shutil.which("tshark"):
        show_tshark(dialogue, log)
    else:
        print("tshark: not installed")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--readers", action="store_true")
    options = parser.parse_args()
    dialogue = held_dialogue()
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "dialogue.log"
        log.write_text(dialogue.log, encoding="ascii")
        if options.readers:
            show_readers(dialogue, log)
            return
        DOCUMENT.write_text(written(DOCUMENT.read_text(encoding="utf-8"), read_by_scapy(log)), encoding="utf-8")


if __name__ == "__main__":
    main()
