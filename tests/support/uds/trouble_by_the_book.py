"""The status of a trouble code from its whole history, as ISO 14229-1 annex D tells it bit by bit.

Nothing is remembered but what happened: every bit is looked up in the past each time it is asked for.
"""

from dataclasses import dataclass, field
from typing import Any

FAILED, PASSED, PREFAILED, PREPASSED = "failed", "passed", "prefailed", "prepassed"


@dataclass
class Cycle:
    """One operation cycle since the last clear: the results of completed tests in it."""

    results: list[bool] = field(default_factory=list)  # True: failed
    is_warm: bool = False

    @property
    def has_failure(self) -> bool:
        return any(self.results)

    @property
    def is_good(self) -> bool:
        return bool(self.results) and not self.has_failure


class TroubleByTheBook:
    def __init__(self, entry: dict[str, Any]) -> None:
        self.entry = entry
        letter, digits = entry["code"][0], entry["code"][1:]
        self.number: int = (("PCBU".index(letter) * 0x4000 + int(digits, 16)) << 8) + entry["failure_type"]
        self.counter = 0
        self.cycles = [Cycle()]

    # --- what happens ---------------------------------------------------------------------------------------------

    def clear(self) -> None:
        self.cycles = [Cycle()]
        self.counter = 0

    def new_cycle(self, *, was_warm: bool) -> None:
        self.cycles[-1].is_warm = was_warm
        self.cycles.append(Cycle())
        self.counter = 0

    def sample(self, result: str) -> None:
        up, down = self.entry.get("failed_step", 127), self.entry.get("passed_step", 128)
        if result == PREFAILED:
            self.counter = min(127, max(0, self.counter) + up)
        elif result == PREPASSED:
            self.counter = max(-128, min(0, self.counter) - down)
        else:
            self.counter = 127 if result == FAILED else -128
        if self.counter in {127, -128}:
            self.cycles[-1].results.append(self.counter == 127)

    # --- what is asked --------------------------------------------------------------------------------------------

    @property
    def ended(self) -> list[Cycle]:
        return self.cycles[:-1]

    @property
    def results(self) -> list[bool]:
        return [result for cycle in self.cycles for result in cycle.results]

    @property
    def last_bad(self) -> int:
        """The place of the last cycle with a failure, -1 if there is none."""
        return max((place for place, cycle in enumerate(self.cycles) if cycle.has_failure), default=-1)

    @property
    def good_since(self) -> list[Cycle]:
        """Ended cycles after the last failure in which the test ran and passed."""
        return [cycle for cycle in self.ended[self.last_bad + 1 :] if cycle.is_good]

    @property
    def is_pending(self) -> bool:
        return self.last_bad >= 0 and not self.good_since

    def bad_in_a_row(self, upto: int) -> int:
        """Cycles with a failure up to this place, back to the last one that only passed."""
        count = 0
        for cycle in reversed(self.cycles[: upto + 1]):
            if cycle.is_good and cycle is not self.cycles[-1]:  # the one that goes on may still fail
                break
            count += cycle.has_failure
        return count

    def confirmed_at(self, place: int) -> bool:
        """Whether the code was confirmed by the failure in the cycle at this place, or was still from before."""
        if self.bad_in_a_row(place) >= self.entry.get("confirm_cycles", 1):
            return True
        before = max((p for p in range(place) if self.cycles[p].has_failure), default=-1)
        if before < 0 or not self.confirmed_at(before):
            return False
        return not self.is_aged(self.cycles[before + 1 : place])

    def good_for_healing(self, cycles: list[Cycle]) -> list[Cycle]:
        return [cycle for cycle in cycles if cycle.is_good]

    def is_aged(self, since: list[Cycle]) -> bool:
        """Whether these cycles, which followed a confirmed failure, are enough to forget it."""
        good = self.good_for_healing(since)
        healed = good[self.entry.get("heal_cycles", 3) :] if self.entry["lights_lamp"] else good
        return bool(sum(cycle.is_warm for cycle in healed) >= self.entry.get("age_cycles", 40))

    @property
    def is_confirmed(self) -> bool:
        place = self.last_bad
        return place >= 0 and self.confirmed_at(place) and not self.is_aged(self.ended[place + 1 :])

    @property
    def is_lamp_wanted(self) -> bool:
        wants = self.entry["lights_lamp"] and self.is_confirmed
        return bool(wants) and len(self.good_since) < self.entry.get("heal_cycles", 3)

    @property
    def has_data(self) -> bool:
        return self.is_pending or self.is_confirmed

    @property
    def status(self) -> int:
        results, now = self.results, self.cycles[-1]
        bits = [
            bool(results) and results[-1],
            now.has_failure,
            self.is_pending,
            self.is_confirmed,
            not results,
            any(results),
            not now.results,
            self.is_lamp_wanted,
        ]
        return sum(1 << place for place, is_set in enumerate(bits) if is_set)

    @property
    def occurrences(self) -> int:
        """Failures after no failure, since the code was last unknown."""
        if not self.has_data:
            return 0
        count, was_failed = 0, False
        for place, cycle in enumerate(self.cycles):
            for result in cycle.results:
                count += result and not was_failed
                was_failed = result
            if place < len(self.cycles) - 1 and cycle.is_good and self._was_forgotten_after(place):
                count = 0
        return min(count, 255)

    def _was_forgotten_after(self, place: int) -> bool:
        """Whether nothing was left of the code once the cycle at this place had ended."""
        past = TroubleByTheBook(self.entry)
        past.cycles = [*self.cycles[: place + 1], Cycle()]
        return not past.has_data
