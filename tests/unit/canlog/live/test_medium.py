"""The choice of a bus: what this kernel offers, never real hardware, and never another demo's frames."""

import json

import can
import pytest

from canlog.errors import SourceError
from canlog.live import medium
from canlog.live.medium import open_medium
from tests.support.patience import HANG_S


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


def test_two_demos_have_ports_of_their_own(monkeypatch: pytest.MonkeyPatch, commands: list[str]) -> None:
    use(monkeypatch, has_can=False)
    with open_medium() as first, open_medium() as second:
        ports = {json.loads(chosen.environment["CAN_CONFIG"])["port"] for chosen in (first, second)}
    assert len(ports) == 2


def test_without_the_right_to_make_one_it_is_multicast(monkeypatch: pytest.MonkeyPatch, commands: list[str]) -> None:
    use(monkeypatch, has_can=True)
    with open_medium() as chosen:
        assert chosen.interface == "udp_multicast"
        assert "root" in chosen.explanation
    assert "ip -json link show up type vcan" in commands  # asks for vcan alone: can0 may be a car


def test_a_vcan_that_is_up_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, has_can=True)
    answers = {"show": '[{}, {"ifname": "vcan3"}]'}
    monkeypatch.setattr(medium, "_run", lambda *words: next((answers[w] for w in words if w in answers), None))
    with open_medium() as chosen:
        assert chosen.arguments == ("-i", "socketcan", "-c", "vcan3")
        assert chosen.environment == {}


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


def test_another_program_opens_it_in_this_machine(monkeypatch: pytest.MonkeyPatch, commands: list[str]) -> None:
    use(monkeypatch, has_can=False)
    with open_medium() as chosen:
        port = chosen.options["port"]
        assert chosen.can_options == {
            "interface": "udp_multicast", "channel": medium.MULTICAST_GROUP, "port": port, "hop_limit": 0,
        }  # fmt: skip
        assert not chosen.is_shared


def test_a_vcan_that_was_asked_for_is_not_replaced(monkeypatch: pytest.MonkeyPatch, commands: list[str]) -> None:
    use(monkeypatch, has_can=False)
    with pytest.raises(SourceError, match=r"there is no vcan interface: .* no CAN"), medium.open_vcan():
        pass


def test_virtual_buses_are_apart() -> None:
    first, second = medium.virtual("of a test"), medium.virtual("of a test")
    with first.open() as near, first.open() as far, second.open() as other:
        near.send(can.Message(arbitration_id=1))
        assert far.recv(timeout=HANG_S) is not None
        assert other.recv(timeout=0.0) is None
        assert near.recv(timeout=0.0) is None
