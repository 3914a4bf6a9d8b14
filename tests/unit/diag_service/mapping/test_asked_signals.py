"""What requests and answers on the bus say becomes samples between them; what is no sound answer becomes none."""

from pathlib import Path

import numpy as np
import pytest

from canlog.database.signal_columns import column_id
from canlog.frames import EXTENDED_FLAG, FrameBatch, join
from diag_service.errors import ConfigError
from diag_service.mapping.asked_signals import AskedField, Overheard
from diag_service.mapping.profile import load_profile
from tests.support.asked import Wire

PRESSURE = AskedField(request_id=0x7E1, reply_id=0x7E9, service=0x22, number=0x38EB, is_signed=True)
TORQUE = AskedField(request_id=0x7E1, reply_id=0x7E9, service=0x22, number=0x100C)
MS = 1_000_000


def batch_of(*says: tuple[float, int, str]) -> FrameBatch:
    wire = Wire(t_ns=0)
    for at_ms, can_id, payload in says:
        wire.t_ns = round(at_ms * MS)
        peer = can_id + 8 if can_id < 0x7E8 else can_id - 8
        wire.say(bytes.fromhex(payload), can_id, peer)
    return wire.batch


def samples(overheard: Overheard, batch: FrameBatch, fields: tuple[AskedField, ...]) -> list[tuple[int, float]]:
    parts = [*overheard.feed(batch), *overheard.drain()]
    out = join(parts)
    assert np.all(np.diff(out.t_ns) >= 0)
    own = np.isin(out.can_id, [column_id(one.name) | EXTENDED_FLAG for one in fields])
    assert (~own).sum() == len(batch)
    values = np.ascontiguousarray(out.data[own]).view("<f8")[:, 0]
    return list(zip((out.t_ns[own] // MS).tolist(), values.tolist(), strict=True))


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        ((20.0, 0x7E9, "6238EB00"), "another length"),
        ((20.0, 0x7E9, "6238EB000102"), "another length"),
        ((20.0, 0x7E9, "62100C0001"), "other numbers"),
        ((20.0, 0x7E9, "7F2231"), "refused with 31"),
        ((400.0, 0x7E9, "6238EB0001"), "no answer in time"),
        ((20.0, 0x7E9, "590238EB"), "to no request"),
    ],
)
def test_what_is_no_sound_answer_gives_no_sample(answer: tuple[float, int, str], why: str) -> None:
    overheard = Overheard([PRESSURE, TORQUE])
    assert samples(overheard, batch_of((10, 0x7E1, "2238EB"), answer), (PRESSURE, TORQUE)) == []
    assert why in " ".join(overheard.faults)


@pytest.mark.parametrize("cut", [1, 2, 7])
def test_samples_do_not_depend_on_how_the_stream_was_cut(cut: int) -> None:
    says = [
        one
        for at in range(0, 2000, 25)
        for one in ((at, 0x7E1, "2238EB100C"), (at + 2, 0x123, "00"), (at + 9, 0x7E9, f"6238EB{at:04X}100C0002"))
    ]
    batch, fields = batch_of(*says), (PRESSURE, TORQUE)
    whole, piecewise = Overheard(fields), Overheard(fields)
    expected = join([*whole.feed(batch), *whole.drain()])
    parts = [part for at in range(0, len(batch), cut) for part in piecewise.feed(batch[at : at + cut])]
    found = join([*parts, *piecewise.drain()])
    assert found.t_ns.tolist() == expected.t_ns.tolist()
    assert found.data.tolist() == expected.data.tolist()
    assert len(expected) == len(batch) + 160


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ("did = 0x38EB", 'lacks at: the identifier of requests, such as "7E1"'),
        ('did = 0x138EB, at = "7E1"', "0x138EB is no number of service 22"),
        ('did = 1, pid = 2, at = "7E1"', "more than one of did, pid, local"),
        ('did = 1, at = "7E1", valid = [30, 0]', r"valid \[30.0, 0.0\] is no range"),
        ('did = 1, at = "XYZ"', "at must be hexadecimal"),
        ('did = 1, at = "123456"', "reply is needed"),
        ('did = 1, at = "7E1", length = 40', "length must be 1 to 32 bits"),
        ('did = 1, at = "7E1", order = "middle"', "order must be big or little"),
        ('did = 1, at = "7E1", message = "M"', "has a message, signal or column beside"),
        ('did = 1, at = "7E1", size = 1', "ends at byte 2, its datum has 1"),
        ('message = "M", signal = "S", at = "7E1"', "at and reply need did, pid or local"),
    ],
)
def test_mistakes_in_a_profile_are_told(tmp_path: Path, entry: str, text: str) -> None:
    path = tmp_path / "some.toml"
    path.write_text(f"[signals]\nclutch1_pressure_pa = {{ {entry} }}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=text):
        load_profile(path)
