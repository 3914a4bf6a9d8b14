"""A bus of multicast UDP stays in this machine unless a hop limit is asked for, in both programs and the demo."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from demo import medium
from tests.reach import FRAME_COUNT, Reach

GROUPS = ("239.74.163.2", "ff15:7079:7468:6f6e:6465:6d6f:6d63:6173")
NAMESPACE = ("unshare", "--net") if os.geteuid() == 0 else ("unshare", "--net", "--map-root-user")


def reach_of(group: str, **variables: str) -> Reach:
    answer = subprocess.run(
        [*NAMESPACE, sys.executable, "-m", "tests.reach", group],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        env={**os.environ, **variables},
    )
    assert answer.returncode == 0, answer.stderr
    return Reach(**json.loads(answer.stdout))


@pytest.mark.parametrize("group", GROUPS)
def test_no_frame_leaves_the_machine_by_default(group: str) -> None:
    reach = reach_of(group)
    assert reach == Reach(heard=FRAME_COUNT, left_udp=0, left_ipv4=0)


@pytest.mark.parametrize("group", GROUPS)
def test_a_hop_that_is_asked_for_puts_the_bus_on_the_network(group: str) -> None:
    reach = reach_of(group, CAN_CONFIG='{"hop_limit": 1}')
    assert (reach.heard, reach.left_udp) == (FRAME_COUNT, FRAME_COUNT)


def test_can_conf_may_ask_for_it_as_well(tmp_path: Path) -> None:
    (tmp_path / "can.conf").write_text("[default]\nhop_limit = 1\n", encoding="utf-8")
    reach = reach_of(GROUPS[0], HOME=str(tmp_path))
    assert reach.left_udp == FRAME_COUNT


def test_the_demos_bus_stays_in_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(medium, "_has_can_sockets", lambda: False)
    with medium.open_medium() as chosen:
        reach = reach_of(chosen.channel, **chosen.environment)
    assert reach == Reach(heard=FRAME_COUNT, left_udp=0, left_ipv4=0)
