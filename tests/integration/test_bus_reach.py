"""A bus of multicast UDP stays in this machine unless a hop limit is asked for, in both programs and the demo."""

import json
import os
import subprocess
import sys
from dataclasses import asdict

import pytest

from canlog.live import medium
from tests.support.patience import HANG_S
from tests.support.reach import FRAME_COUNT, Case, Reach

IPV4, IPV6 = "239.74.163.2", "ff15:7079:7468:6f6e:6465:6d6f:6d63:6173"
NAMESPACE = ("unshare", "--net") if os.geteuid() == 0 else ("unshare", "--net", "--map-root-user")
ONE_HOP = {"CAN_CONFIG": '{"hop_limit": 1}'}


def demo_case() -> Case:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(medium, "_has_can_sockets", lambda: False)
        with medium.open_medium() as chosen:
            return Case(group=chosen.channel, variables=dict(chosen.environment))


@pytest.fixture(scope="module")
def reaches(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Reach]:
    """Return what became of the frames in each case, all in one namespace."""
    home = tmp_path_factory.mktemp("home")
    (home / "can.conf").write_text("[default]\nhop_limit = 1\n", encoding="utf-8")
    cases = {
        "IPv4": Case(group=IPV4),
        "IPv6": Case(group=IPV6),
        "demo": demo_case(),
        "IPv4, one hop": Case(group=IPV4, variables=ONE_HOP),
        "IPv6, one hop": Case(group=IPV6, variables=ONE_HOP),
        "can.conf": Case(group=IPV4, variables={"HOME": str(home)}),
    }
    asked = json.dumps([asdict(case) for case in cases.values()])
    answer = subprocess.run(
        [*NAMESPACE, sys.executable, "-m", "tests.support.reach", asked],
        capture_output=True,
        text=True,
        check=False,
        timeout=HANG_S,
        env={name: value for name, value in os.environ.items() if not name.startswith("CAN_")},
    )
    assert answer.returncode == 0, answer.stderr
    lines = answer.stdout.splitlines()
    return {name: Reach(**json.loads(line)) for name, line in zip(cases, lines, strict=True)}


@pytest.mark.parametrize("name", ["IPv4", "IPv6", "demo"])
def test_nothing_leaves_the_machine_by_default(reaches: dict[str, Reach], name: str) -> None:
    assert reaches[name] == Reach(heard=FRAME_COUNT, left_udp=0, left_ipv4=0)


@pytest.mark.parametrize("name", ["IPv4, one hop", "IPv6, one hop", "can.conf"])
def test_a_hop_that_is_asked_for_puts_the_bus_on_the_network(reaches: dict[str, Reach], name: str) -> None:
    assert (reaches[name].heard, reaches[name].left_udp) == (FRAME_COUNT, FRAME_COUNT)
