"""The Python that docs/howto.md shows and names does what the page says."""

import asyncio
import re
import runpy
import textwrap
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from canlog.frames import TX_FLAG
from canlog.logs.log_counts import LogCounts
from canlog.logs.text_log import frames_of
from diag_service.delivery import Outbox
from diag_service.store import ResultStore, VehicleState, Versions
from fleet_contract import Channel, read_message
from tests.support.builders import shift_result
from tests.support.documents import ROOT, page_text

BLOCK = re.compile(r"^( *)```python\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
STATE = VehicleState(filter_state={}, condition={}, versions=Versions(algorithm="a", calibration="c"))


def names_of(class_name: str) -> dict[str, Any]:
    """Return what the block that defines a class leaves behind."""
    (code,) = (body for _, body in BLOCK.findall(page_text("docs/howto.md")) if f"class {class_name}" in body)
    names: dict[str, Any] = {"__name__": "howto"}
    exec(textwrap.dedent(code), names)  # noqa: S102 - the document's own code
    return names


def test_the_layout_reads_a_log() -> None:
    counts = LogCounts()
    text = b"# plain-can 1\n1767225600.001000 1 0B0 rx 2 51 D0\n1767225600.5 2 18FEF100 tx 1 07\n1.5 1 0B0 rx 2 51"
    batch = frames_of(names_of("Plain")["Plain"](), text, counts)
    assert batch.t_ns.tolist() == [1_767_225_600_001_000_000, 1_767_225_600_500_000_000]
    assert batch.can_id.tolist() == [0x0B0, 0x98FEF100]
    assert [bytes(row[:length]) for row, length in zip(batch.data, batch.length, strict=True)] == [b"\x51\xd0", b"\x07"]
    assert batch.channel.tolist() == [1, 2]
    assert batch.flags.tolist() == [0, TX_FLAG]
    assert counts.skipped == 1
    assert sum(counts.rejected.values()) == 1


async def test_the_link_takes_what_the_outbox_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with closing(ResultStore.in_memory()) as store:
        for seq in (1, 2):
            store.add(shift_result(seq), STATE)
        outbox = Outbox(
            store, "car1", runpy.run_path(str(ROOT / "examples" / "spool_link.py"))["connect"], "spool.jsonl"
        )
        sender = asyncio.create_task(outbox.run())
        assert await outbox.close(sender) == 0
        assert store.unpublished_count("car1") == 0
    lines = (tmp_path / "spool.jsonl").read_bytes().splitlines()
    messages = [read_message(topic.decode(), payload) for topic, _, payload in (line.partition(b" ") for line in lines)]
    assert [one.data["seq"] for one in messages if one.address.channel is Channel.SHIFT] == [1, 2]
