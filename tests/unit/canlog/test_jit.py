"""A kernel computes what its source says."""

from canlog.jit import array_kernel, kernel


def test_a_kernel_computes_what_its_source_says() -> None:
    @kernel
    def twice(value: float) -> float:
        return 2.0 * value

    assert twice(1.5) == 3.0


def test_a_kernel_without_reference_counts_computes_the_same() -> None:
    @array_kernel
    def twice(value: float) -> float:
        return 2.0 * value

    assert twice(1.5) == 3.0
