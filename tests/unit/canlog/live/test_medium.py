"""The choice of a bus: what this kernel offers, never real hardware, and never another demo's frames."""

import json

import pytest

from canlog.live import medium
from canlog.live.medium import open_medium


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Let every program of the system fail, and note what was asked of it."""
    asked: list[str] = []

    def refuse(program: str, *arguments: str) -> None:
        asked.append(" ".join((program, *arguments)))

    monkeypatch.setattr(medium, "_run", refuse)
    return asked


def use(monkeypatch: pytest.MonkeyPatch, *, has_can: bool) -> None:
    monkeypatch.setattr(medium, "_has_can_sockets", lambda: has_can)


def test_without_can_in_the_kernel_it_is_multicast_and_says_why(
    monkeypatch: pytest.MonkeyPatch, commands: list[str]
) -> None:
    use(monkeypatch, has_can=False)
    with open_medium() as chosen:
        assert chosen.arguments == ("-i", "udp_multicast", "-c", medium.MULTICAST_GROUP)
        assert "no CAN" in chosen.explanation
        assert set(json.loads(chosen.environment["CAN_CONFIG"])) == {"port"}  # no reach is asked for
    assert not any(command.startswith("ip ") for command in commands)


def test_a_vcan_of_our_own_goes_with_us(monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, has_can=True)
    asked: list[tuple[str, ...]] = []

    def obey(*words: str) -> str:
        asked.append(words)
        return ""

    monkeypatch.setattr(medium, "_run", obey)
    with open_medium() as chosen:
        assert chosen.interface == "socketcan"
        assert len(chosen.channel) <= 15  # the kernel's limit
        assert ("ip", "link", "set", chosen.channel, "up") in asked
    assert asked[-1] == ("ip", "link", "delete", chosen.channel)
