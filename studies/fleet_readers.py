"""Readers of the fleet's page, in a process of their own: each looks at the fleet, then at a vehicle in it, and so on.

As the page's script does, a reader follows what it looks at and asks again when the server says that it changed. Prints
"ready" when it begins, and in the end how long each page took, as JSON.

    python -m studies.fleet_readers http://127.0.0.1:8090 --readers 50 --seconds 30
"""

import argparse
import asyncio
import json
import random
import re
import sys
import time
from contextlib import suppress

import httpx

THINKING_S = 5.0  # of a reader between two pages, on average
_VEHICLES = re.compile(r'href="(/vehicles/[^"/?]+)"')
_NUMBER = re.compile(r'data-number="(\d+)"')
_FLEET = ("/", "/?condition=watch", "/?condition=change_fluid&limit=200", "/?q=v1", "/?q=v77")

Times = dict[str, list[float]]


class Reader:
    """One person before a browser."""

    def __init__(self, client: httpx.AsyncClient, number: int, times_s: Times) -> None:
        self._client = client
        self._rng = random.Random(number)  # noqa: S311 - no secret
        self._times_s = times_s

    async def read(self, end_s: float) -> None:
        """Read until a moment."""
        await asyncio.sleep(self._rng.uniform(0.0, THINKING_S))
        path, kind = self._rng.choice(_FLEET), "fleet"
        while time.monotonic() < end_s:
            text = await self._page(path, kind)
            thinking_s = min(self._rng.uniform(0.0, 2.0 * THINKING_S), max(end_s - time.monotonic(), 0.0))
            await self._look(path, kind, text, thinking_s)
            seen = _VEHICLES.findall(text)
            is_next_vehicle = kind == "fleet" and seen
            path, kind = (self._rng.choice(seen), "vehicle") if is_next_vehicle else (self._rng.choice(_FLEET), "fleet")

    async def _page(self, path: str, kind: str) -> str:
        began_s = time.perf_counter()
        answer = await self._client.get(path)
        answer.raise_for_status()
        self._times_s[kind].append(time.perf_counter() - began_s)
        return answer.text

    async def _look(self, path: str, kind: str, text: str, thinking_s: float) -> None:
        """Follow what is looked at; a page that was renewed is followed from its new state on."""
        found = _NUMBER.search(text)
        words = {"number": found[1] if found else "0"}
        if kind == "vehicle":
            words["vehicle"] = path.rpartition("/")[2]
        with suppress(TimeoutError):
            async with asyncio.timeout(thinking_s), self._client.stream("GET", "/events", params=words) as news:
                async for line in news.aiter_lines():
                    if line.startswith("event: news"):
                        await self._page(path, kind)


async def read_together(address: str, count: int, reading_s: float) -> Times:
    """Return how long the pages of each kind took."""
    times_s: Times = {"fleet": [], "vehicle": []}
    limits = httpx.Limits(max_connections=3 * count)
    async with httpx.AsyncClient(base_url=address, timeout=60.0, trust_env=False, limits=limits) as client:
        print("ready", flush=True)
        end_s = time.monotonic() + reading_s
        await asyncio.gather(*(Reader(client, number, times_s).read(end_s) for number in range(count)))
    return times_s


def main() -> int:
    """Read, and print how long it took."""
    parser = argparse.ArgumentParser(description="Readers of the fleet's page.")
    parser.add_argument("address")
    parser.add_argument("--readers", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=30.0)
    options = parser.parse_args()
    print(json.dumps(asyncio.run(read_together(options.address, options.readers, options.seconds))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
