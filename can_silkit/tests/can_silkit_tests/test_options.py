"""What needs no simulation: options that cannot be, and the word about a binding that is missing."""

import sys

import can
import pytest


def test_the_interface_is_known_to_python_can() -> None:
    assert "silkit" in can.VALID_INTERFACES


def test_without_the_binding_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "SilKit_py", None)  # as where it is not
    with pytest.raises(can.CanInterfaceNotImplementedError, match=r"pip install silkit-py, with Python 3\.12"):
        can.Bus("CAN1", interface="silkit")


@pytest.mark.parametrize("step_s", [0.0, -1.0, 0.2])
def test_a_step_that_cannot_be_is_refused(step_s: float) -> None:
    with pytest.raises(ValueError, match=r"step_s must be above 0 and at most 0\.1 s"):
        can.Bus("CAN1", interface="silkit", step_s=step_s)


@pytest.mark.parametrize("patience_s", [0.0, -1.0, float("nan")])
def test_patience_that_cannot_be_is_refused(patience_s: float) -> None:
    with pytest.raises(ValueError, match=r"patience_s must be above 0 s"):
        can.Bus("CAN1", interface="silkit", patience_s=patience_s)
