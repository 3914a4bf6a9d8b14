"""A kernel computes what its source says."""

from typing import Any

from numba.core import types

from canlog.jit import kernel


def test_a_kernel_has_one_form_whatever_constants_others_call_it_with() -> None:
    @kernel
    def times(value: int, factor: int) -> int:
        return value * factor

    dispatcher: Any = times
    for factor in (types.IntegerLiteral(4), types.IntegerLiteral(64), types.int64):
        dispatcher.get_call_template((types.int64, factor), {})  # as a kernel that calls it does
    assert dispatcher.signatures == [(types.int64, types.int64)]
    assert times(3, 4) == 12
