"""A wheel of ``canlog`` in an environment that has what it requires and nothing of the project besides."""

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import can
import pytest

from canlog import load_database
from tests.support.distributions import PACKAGES, ROOT
from tests.support.plain_install import PlainInstall, distributions_of, linked_environment
from tests.support.wheels import built_wheels, install

FOLDER = ROOT / "canlog"
DATABASE = """VERSION ""
BU_: A
BO_ 256 Engine: 8 A
 SG_ Speed : 0|16@1+ (0.25,0) [0|16383] "rpm" A
 SG_ Torque : 23|16@0- (0.1,-5) [-3000|3000] "Nm" A
BO_ 2147484160 Gear: 2 A
 SG_ Page M : 0|8@1+ (1,0) [0|1] "" A
 SG_ Current m0 : 8|4@1+ (1,0) [0|7] "" A
 SG_ Target m1 : 8|4@1+ (1,0) [0|7] "" A
"""
# What its README shows: three lines from a log to a table, and then what else there is.
THREE_LINES, MORE_LINES = re.findall(
    r"^```python$(.*?)^```$", (FOLDER / "README.md").read_text(), re.DOTALL | re.MULTILINE
)
WATCHED = f"""
import importlib.util, json, sys
from canlog.jit import on_compiling
compiled = []
on_compiling(compiled.append)
{THREE_LINES}
polars, pandas = table, log.to_pandas("wide")
{MORE_LINES}
columns = [name for name in pandas.columns if "." in name]
print(json.dumps({{
    "pandas": [{{name: row[name] for name in columns if row[name] == row[name]}} for row in pandas.to_dict("records")],
    "polars": [{{name: row[name] for name in columns if row[name] is not None}} for row in polars.to_dicts()],
    "times": [str(polars["time"].dtype), str(pandas["time"].dtype)],
    "losses": log.losses,
    "compiled": compiled,
    "ours": [name for name in {list(PACKAGES)!r} if name != "canlog" and importlib.util.find_spec(name)],
    "home": canlog.__file__,
}}))
"""


@pytest.fixture(name="alone", scope="module")
def _alone(shared_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> PlainInstall:
    """Install it; what it requires is linked, so that nothing is fetched."""
    folder = tmp_path_factory.mktemp("alone")
    extras = library()["optional-dependencies"]
    linked_environment(folder, distributions_of([*library()["dependencies"], *extras["pandas"], *extras["polars"]]))
    return install(folder, built_wheels(shared_folder)["canlog"])


def library() -> dict[str, Any]:
    table: dict[str, Any] = tomllib.loads((FOLDER / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return table


def write_drive(folder: Path) -> list[dict[str, float]]:
    """Write a BLF log and its database; return what cantools says of every frame."""
    (folder / "car.dbc").write_text(DATABASE, encoding="ascii")
    database = load_database(folder / "car.dbc")
    expected: list[dict[str, float]] = []
    with can.BLFWriter(folder / "drive.blf") as writer:
        for number in range(60):
            message = database.messages[number % 2]
            payload = (
                bytes((number // 2 % 2, number % 8))
                if number % 2
                else bytes((number * 7 + place) % 256 for place in range(8))
            )
            writer.on_message_received(
                can.Message(
                    timestamp=1.7e9 + number / 1000, arbitration_id=message.frame_id,
                    is_extended_id=message.is_extended_frame, data=payload,
                )
            )  # fmt: skip
            values: dict[str, Any] = dict(message.decode(payload, decode_choices=False))  # type: ignore[arg-type]  # not a container
            expected.append({f"{message.name}.{name}": value for name, value in values.items()})
    return expected


def test_three_lines_read_a_log_into_pandas_and_polars(alone: PlainInstall, tmp_path: Path) -> None:
    expected = write_drive(tmp_path)
    done = alone.run("-W", "error", "-c", WATCHED, cwd=tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert done.status == 0, done.err
    told = json.loads(done.out.splitlines()[-1])
    assert (tmp_path / "drive.parquet").is_file()
    assert told["pandas"] == expected
    assert told["polars"] == expected
    assert told["times"] == ["Datetime(time_unit='ns', time_zone='UTC')", "datetime64[ns, UTC]"]
    assert told["losses"] == []
    assert told["ours"] == []
    assert Path(told["home"]).is_relative_to(alone.python.parents[1])
    assert told["compiled"]
    assert [name for name in told["compiled"] if not name.startswith(("canlog.", "numba."))] == []
