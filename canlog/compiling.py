"""What a program says while it compiles its kernels: the first start on a machine, and the first after an update."""

from collections.abc import Callable

from canlog.kernel_cache import has_cache, kernel_count, on_compiling

STEP = 20  # kernels between two lines


def tell_of_compiling(say: Callable[[str], object]) -> None:
    """Have ``say`` called with a line for people when this process begins to compile, and with more as it goes on."""
    count = 0

    def tell(_name: str) -> None:
        nonlocal count
        if count == 0:
            say(f"compiling numerical kernels, {_how_often()}; this takes up to a minute")
        elif count % STEP == 0:
            say(f"compiling numerical kernels: {count} done, at most {kernel_count()} to do in all")
        count += 1

    on_compiling(tell)


def _how_often() -> str:
    if has_cache():
        return "as at every first start"
    return "as at every start, since no folder can be written for them (NUMBA_CACHE_DIR names one)"
