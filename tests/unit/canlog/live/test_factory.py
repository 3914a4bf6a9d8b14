"""Which bus a user means: the command line over the environment over can.conf, as python-can has it."""

from pathlib import Path

import pytest

from canlog.live.factory import complete_settings


@pytest.fixture(autouse=True)
def _at_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_BITRATE", "CAN_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    text = "[default]\ninterface = virtual\nchannel = garage\nbitrate = 250000\n"
    (tmp_path / "can.conf").write_text(text, encoding="ascii")


def test_can_conf_stands_for_what_is_not_said(monkeypatch: pytest.MonkeyPatch) -> None:
    found = complete_settings(None, None, None, fd=False)
    assert (found.interface, found.channel, found.bitrate) == ("virtual", "garage", 250_000)
    monkeypatch.setenv("CAN_CHANNEL", "street")
    assert complete_settings(None, None, None, fd=False).channel == "street"
    assert complete_settings("virtual", "yard", 125_000, fd=False).channel == "yard"
