"""A tool that knows a controller by its PDX alone: what it asks is answered, what is answered it understands."""

from collections.abc import Iterator
from random import Random
from typing import Any

import pytest

from tests.support.uds.full_table import full_table
from tests.support.uds.pdx_client import PdxClient, read_back, templates_compiled_once
from tests.tools.pdx.package import FILE, pdx_package
from workshop.controller.table import shipped_table


@pytest.fixture(scope="module", autouse=True)
def _compiled_once() -> Iterator[None]:
    with templates_compiled_once():
        yield


def test_everything_that_the_package_describes_is_answered_and_understood() -> None:
    figures = PdxClient(full_table(), Random(1)).ask_everything()  # noqa: S311 - to be repeated
    assert figures.problems == []
    assert [name for name in figures.requests if not figures.positive[name]] == []
    assert figures.negative.total() > 100


def test_obd_is_a_layer_of_its_own_of_which_everything_is_answered_and_understood() -> None:
    client = PdxClient(shipped_table(), Random(1), container=1)  # noqa: S311 - to be repeated
    figures = client.ask_everything(most_situations=6)
    assert figures.problems == []
    assert [name for name in figures.requests if not figures.positive[name]] == []
    assert {name.partition("_")[0] for name in figures.requests} == {"Read", "Clear"}
    speed = client.layer.services.Read_engine_speed
    assert bytes(speed.encode_request()) == b"\x01\x0c"
    assert speed.decode_message(b"\x41\x0c\x10\x00").param_dict["engine_speed"] == {"speed": 1024.0}
    codes: Any = client.layer.services.Read_confirmed_trouble_codes.decode_message(b"\x43\x01\x08\x11").param_dict
    assert [code["trouble_code"].display_trouble_code for code in codes["trouble_codes"]] == ["P0811"]


def test_the_package_that_ships_is_that_of_the_table_that_ships() -> None:
    assert FILE.read_bytes() == pdx_package(shipped_table())
    assert read_back(FILE.read_bytes()).short_name == "TCU"
