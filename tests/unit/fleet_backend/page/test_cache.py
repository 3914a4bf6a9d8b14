"""What was worked out is kept while what it was made of stays the same, in bounded memory, and not for ever."""

from fleet_backend.page.cache import LONGEST_S, Cache


class Maker:
    """Makes values, and counts them."""

    def __init__(self, length: int = 1) -> None:
        self.count = 0
        self._length = length

    def __call__(self) -> list[int]:
        self.count += 1
        return [self.count] * self._length


def test_what_nobody_asked_for_longest_goes_first_and_all_goes_in_time() -> None:
    now_s = 0.0
    remembered, make = Cache(5, len, clock=lambda: now_s), Maker(2)
    for key in ("a", "b", "a", "c"):
        remembered.of(key, 0, make)
    assert make.count == 3
    remembered.of("a", 0, make)
    assert make.count == 3
    remembered.of("b", 0, make)
    assert make.count == 4
    now_s = LONGEST_S
    remembered.of("b", 0, make)
    assert make.count == 5
