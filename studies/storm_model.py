"""A reconnect storm as discrete events: vehicles come back within a window, each with a backlog, to a steady ingest.

Connections come first: each takes the broker a while. Results wait at the broker in the order in which they were sent;
workers take them at their pace. It knows nothing of retries, since a vehicle whose results wait sends them again only
after seconds, and these are known by their key.

    python -m studies.storm_model --vehicles 1000000 --results 100 --window 1800 --pace 15000 --nodes 4
"""

import argparse
import heapq
import random
from collections.abc import Iterator
from dataclasses import dataclass

RESULT_BYTES = 625  # of a result in a bundle; alone it has 3,000


@dataclass(frozen=True, slots=True, kw_only=True)
class Storm:
    """What comes back, and what it comes back to."""

    vehicle_count: int
    results_each: int
    window_s: float  # in which vehicles connect, at random
    pace_per_s: float  # results that one node's workers take
    connect_s: float = 0.0  # of the broker's time for a connection
    node_count: int = 1
    result_bytes: int = RESULT_BYTES  # on air
    seed: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """How it went."""

    all_in_s: float  # since the first connection could come
    most_waiting: int  # results at the brokers
    newest_median_s: float  # from a vehicle's connection until its newest result is in
    newest_p99_s: float


def play(storm: Storm) -> Course:
    """Return how a storm goes."""
    rng = random.Random(storm.seed)  # noqa: S311 - no secret
    came_s = sorted(rng.uniform(0.0, storm.window_s) for _ in range(storm.vehicle_count))
    courses = [_node(came_s[number :: storm.node_count], storm) for number in range(storm.node_count)]
    waits_s = sorted(wait for _, _, waits in courses for wait in waits)
    return Course(
        all_in_s=max(end_s for end_s, _, _ in courses),
        most_waiting=sum(most for _, most, _ in courses),
        newest_median_s=waits_s[len(waits_s) // 2],
        newest_p99_s=waits_s[min(len(waits_s) - 1, int(0.99 * len(waits_s)))],
    )


def _node(came_s: list[float], storm: Storm) -> tuple[float, int, list[float]]:
    """Return when one node has all, how many results waited there at most, and each vehicle's wait for its newest."""
    accepted: list[tuple[float, float]] = []
    free_s = 0.0
    for moment_s in came_s:
        free_s = max(free_s, moment_s) + storm.connect_s
        accepted.append((free_s, moment_s))
    ends: list[float] = []  # of vehicles whose results wait, as a heap
    waits_s, most, free_s = [], 0, 0.0
    for sent_s, moment_s in accepted:
        while ends and ends[0] <= sent_s:
            heapq.heappop(ends)
        begin_s = max(free_s, sent_s)
        free_s = begin_s + storm.results_each / storm.pace_per_s
        heapq.heappush(ends, free_s)
        waits_s.append(begin_s + 1.0 / storm.pace_per_s - moment_s)
        most = max(most, round((free_s - sent_s) * storm.pace_per_s))
    return free_s, most, waits_s


def told(course: Course, storm: Storm) -> Iterator[str]:
    """Yield the course of a storm in words."""
    yield f"all in after {course.all_in_s:.0f} s, at most {course.most_waiting:,} results wait"
    size_mib = course.most_waiting * storm.result_bytes / 2**20
    yield f" ({size_mib:,.0f} MiB at the brokers); the newest of a vehicle is in after"
    yield f" {course.newest_median_s:.1f} s (median), {course.newest_p99_s:.1f} s (99 %)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=10_000)
    parser.add_argument("--results", type=int, default=100, help="of each")
    parser.add_argument("--window", type=float, default=60.0, help="seconds in which they connect")
    parser.add_argument("--pace", type=float, default=15_000.0, help="results per second of one node's workers")
    parser.add_argument("--connect-ms", type=float, default=0.2, help="of a broker for one connection")
    parser.add_argument("--nodes", type=int, default=1)
    parser.add_argument("--bytes", type=int, default=RESULT_BYTES, help="of a result on air; alone it has 3000")
    options = parser.parse_args()
    storm = Storm(
        vehicle_count=options.vehicles,
        results_each=options.results,
        window_s=options.window,
        pace_per_s=options.pace,
        connect_s=options.connect_ms / 1000.0,
        node_count=options.nodes,
        result_bytes=options.bytes,
    )
    print("".join(told(play(storm), storm)))


if __name__ == "__main__":
    main()
