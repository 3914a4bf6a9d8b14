"""Environment variables: those of either program are known, others are a mistake."""

import pytest

from fleet_backend import arguments
from fleet_contract import VariableError, check_variables
from fleet_contract.settings import BACKEND_VARIABLES


def test_those_of_the_backend_are_those_that_its_command_line_names() -> None:
    assert {value for name, value in vars(arguments).items() if name.endswith("_VARIABLE")} == BACKEND_VARIABLES


@pytest.mark.parametrize(
    ("name", "nearest"),
    [
        ("CLUTCHDIAG_DATABSE", "CLUTCHDIAG_DATABASE"),
        ("CLUTCHDIAG_BROKER_URL", "CLUTCHDIAG_BROKER"),
        ("CLUTCHDIAG_STOREBUDGET", "CLUTCHDIAG_STORE_BUDGET"),
    ],
)
def test_the_nearest_name_is_told(name: str, nearest: str) -> None:
    with pytest.raises(VariableError, match=rf"{name}, .* {nearest}$"):
        check_variables({name: "set"})
