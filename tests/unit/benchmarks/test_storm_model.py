"""The model of reconnect storms, held against cases that can be worked out by hand."""

from dataclasses import replace

import pytest

from benchmarks.storm_model import Storm, play

SMALL = Storm(vehicle_count=100, results_each=10, window_s=0.0, pace_per_s=100.0)


def test_all_at_once_take_as_long_as_the_ingest_needs() -> None:
    course = play(SMALL)
    assert course.all_in_s == pytest.approx(10.0)
    assert course.most_waiting == 1000
    assert course.newest_median_s == pytest.approx(5.0, abs=0.1)


def test_an_ingest_that_is_fast_enough_leaves_nobody_waiting() -> None:
    course = play(replace(SMALL, window_s=60.0, pace_per_s=1e6))
    assert course.all_in_s <= 60.1
    assert course.newest_p99_s < 0.01


def test_nodes_share_and_connections_cost() -> None:
    assert play(replace(SMALL, node_count=4)).all_in_s == pytest.approx(2.5)
    assert play(replace(SMALL, connect_s=1.0)).all_in_s == pytest.approx(100.1)
