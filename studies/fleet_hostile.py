"""What one vehicle that means ill costs the others: 1,000 results of 20 vehicles, without it and while it attacks.

It has a certificate of its own and the brokers are as docs/deploy has them. It subscribes to what is others', takes
over sessions, floods, retains, leaves wills and huge sessions, fills the broker's memory, listens on the port of NATS.

    python -m studies.fleet_hostile
"""

import argparse
import asyncio
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.support.hostile_vehicle import TRACES, attack

LATER_S = 60.0  # than usual, at most
TOPICS, PARTS = 1_200, 1_040  # of 100 kB: retained, and of quality 2 that are never released
KEPT_MB = 50.0  # by which a broker may grow, at most


def main() -> int:
    """Print the figures; return 0 if all keep their aims."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--results", type=int, default=50, help="of each")
    options = parser.parse_args()
    names, is_kept = [f"car{number}" for number in range(1, options.vehicles + 1)], True
    for kind in TRACES:
        with TemporaryDirectory() as folder:
            found = asyncio.run(attack(Path(folder), kind, names, options.results, TOPICS, PARTS))
        lost_count = 2 * options.vehicles * options.results - found.stored_count
        later_s, unseen = found.took_s - found.usual_s, found.unseen(kind)
        print(
            f"{kind}: {options.vehicles * options.results} results usually in {found.usual_s:.1f} s, under attack in"
            f" {found.took_s:.1f} s (aim {LATER_S:g} s later at most), {lost_count} lost; {len(found.granted)}"
            f" subscriptions granted, {len(found.heard)} messages heard; the broker grew by"
            f" {found.kept_bytes / 1e6:.0f} MB for {found.sent_bytes / 1e6:.0f} MB (aim {KEPT_MB:g} MB at most);"
            f" attempts that its log does not tell: {unseen}",
            flush=True,
        )
        is_kept = is_kept and later_s <= LATER_S and found.kept_bytes <= KEPT_MB * 1e6
        is_kept = is_kept and not (lost_count or found.granted or found.heard or unseen)
    return 0 if is_kept else 1


if __name__ == "__main__":
    sys.exit(main())
