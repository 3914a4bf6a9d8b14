"""Messages longer than a frame are rows of every table: the values are those of cantools, what is lost is counted."""

from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow.parquet as pq
import pytest
from cantools.database import load_string
from cantools.database.can import Database

import canlog
from canlog.column_files import TableFormat
from canlog.database.addressing import NOBODY
from canlog.decode.codec import Codec
from canlog.frames import FrameBatch
from canlog.tables.decoding import Plan, decode_logs
from canlog.transport import Reassembler
from tests.support.transport_traffic import Sent, batch_of, generator, iso_tp, j1939

COUNT: Final = 40  # messages of each protocol
LOST: Final = 0.05
J1939_IDS: Final = (0x98FECAFE, 0x98FEEBFE, 0x98EF00FE)
ISO_TP_IDS: Final = (0x7E0, 0x7E8, 0x98DA10F1, 0x98DAF110)

LATE_NS: Final = 1_250_000_000  # so long may pass until a message of J1939 is sure to be whole
Values = dict[tuple[int, str], list[dict[str, float]]]  # of messages by time and name


def database() -> Database:
    lines = ['VERSION ""', "BU_: A"]
    for number, can_id in enumerate((*J1939_IDS, *ISO_TP_IDS)):
        size, far = 60, 8 * 56
        lines += [
            f"BO_ {can_id} Long{number}: {size} A",
            ' SG_ Number : 0|32@1+ (1,0) [0|0] "" A',
            ' SG_ Page M : 32|2@1+ (1,0) [0|0] "" A',
            *(f' SG_ Some{page} m{page} : 40|{9 + page}@1- (0.5,-10) [0|100] "km" A' for page in range(4)),
            f' SG_ Far : {far}|20@1- (0.1,0) [0|0] "bar" A',
            "",
        ]
    lines += [f'BA_DEF_ BO_ "VFrameFormat" ENUM {",".join(4 * [chr(34) + "x" + chr(34)])};']
    text = "\n".join(lines).replace('ENUM "x","x","x","x"', 'ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG"')
    text += '\nBA_DEF_DEF_ "VFrameFormat" "StandardCAN";\n'
    text += "".join(f'BA_ "VFrameFormat" BO_ {can_id} 3;\n' for can_id in J1939_IDS)
    loaded = load_string(text, "dbc", strict=False)
    assert isinstance(loaded, Database)
    return loaded


def recorded(path: Path) -> FrameBatch:
    """Write a log of all protocols, with holes; return its frames."""
    rng = generator(7)
    traffic = [maker(rng, COUNT).frames for maker in (j1939, iso_tp, iso_tp)]
    frames = sorted((one for frames in traffic for one in frames if rng.random() >= LOST), key=lambda one: one.t_ns)
    # The last is CAN FD: it holds at once what else takes many frames.
    frames.append(Sent(t_ns=frames[-1].t_ns + 10**9, can_id=0x98FECA03, data=bytes(range(64)), message=-1))
    batch = batch_of(frames)
    with path.open("w", encoding="ascii") as log:
        for one in frames:
            identifier = f"{one.can_id & 0x1FFFFFFF:08X}" if one.can_id >> 31 else f"{one.can_id:03X}"
            mark = "##0" if len(one.data) > 8 else "#"
            log.write(f"({one.t_ns / 1e9:.6f}) can0 {identifier}{mark}{one.data.hex()}\n")
    return batch


def expected(batch: FrameBatch) -> tuple[Values, int]:
    """Return what cantools says of the whole messages, and how many are not whole."""
    together, codec = Reassembler(), Codec(database().messages, has_long=True)
    found: Values = defaultdict(list)
    for one in [*together.feed(batch), *together.close()]:
        if (slot := codec.slot_of(one.can_id)) != NOBODY:
            message = codec.tables[slot].message
            decoded = message.decode(one.data, decode_choices=False, allow_truncated=True)
            assert isinstance(decoded, dict)
            if decoded:
                found[one.last_ns, message.name].append({name: float(str(cell)) for name, cell in decoded.items()})
    last = database().get_message_by_name("Long0").decode(bytes(range(60)), decode_choices=False)
    assert isinstance(last, dict)
    found[int(batch.t_ns[-1]), "Long0"].append({name: float(str(value)) for name, value in last.items()})
    return found, together.counts.incomplete_count


def wide_values(rows: list[dict[str, Any]]) -> Values:
    found: Values = defaultdict(list)
    for row in rows:
        own = {name.partition(".")[2]: cell for name, cell in row.items() if "." in name and cell is not None}
        found[row["time"].value, row["message"]].append(own)
    return found


@pytest.mark.parametrize("max_frames", [100, 1_000_000])
def test_tables_have_what_cantools_decodes(tmp_path: Path, max_frames: int) -> None:
    batch = recorded(tmp_path / "drive.log")
    values, incomplete_count = expected(batch)
    assert len(values) > COUNT
    assert incomplete_count > 5
    plan = replace(Plan.of(database().messages), max_frames=max_frames)
    output = tmp_path / "wide.parquet"
    account = decode_logs([tmp_path / "drive.log"], plan, output, TableFormat.PARQUET).account
    rows = pq.read_table(output).to_pylist()
    assert wide_values(rows) == values
    t_ns = np.array([row["time"].value for row in rows])
    assert (t_ns >= np.maximum.accumulate(t_ns) - LATE_NS).all()
    assert account.transfers.incomplete_count == incomplete_count
    assert account.is_balanced
    log = canlog.read(tmp_path / "drive.log", database())
    assert wide_values(log.to_arrow("wide", is_raw=True).to_pylist()) == values
    numbers = [one["Number"] for (_, name), each in values.items() if name == "Long3" for one in each]
    assert sorted(log.signals()["Long3.Number"].value.tolist()) == sorted(numbers)
