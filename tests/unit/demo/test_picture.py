"""The picture of a demonstration."""

from pathlib import Path

import numpy as np

from canlog.arrays import Series
from demo.picture import draw
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import EndReason, Event
from tests.unit.demo.outcomes import good_outcome

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"


def test_a_picture_is_drawn(tmp_path: Path) -> None:
    t_ns = np.arange(-50, 150) * 10_000_000
    series = Series(t_ns=t_ns, sequence=np.arange(len(t_ns)), value=np.linspace(100.0, 300.0, len(t_ns)))
    event = Event(
        number=1,
        from_gear=1,
        to_gear=2,
        start_ns=0,
        end_ns=1_000_000_000,
        end_reason=EndReason.COMPLETE,
        columns={Signal.ENGINE_SPEED: series, Signal.CLUTCH2_PRESSURE: series, Signal.ENGINE_TORQUE: series},
        bad_frame_count=0,
    )
    path = tmp_path / "demo.png"
    draw(path, event, good_outcome())
    content = path.read_bytes()
    assert content.startswith(PNG_MAGIC)
    assert len(content) > 20_000
