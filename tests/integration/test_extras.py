"""Every command of every program without extras: help and version as ever, else one line that says what to install."""

import re
from collections.abc import Mapping
from pathlib import Path

import pytest

from diag_service.cli import command_line as diag_service_line
from ecu_emulator.cli import command_line as ecu_emulator_line
from fleet_backend.cli import command_line as fleet_backend_line
from tests.support.documents import MODULES
from tests.support.plain_install import Outcome, PlainInstall, extra_modules, plain_install

COMMANDS = {str(one.name): list(one.commands) for one in (ecu_emulator_line, diag_service_line, fleet_backend_line)}
CANDUMP = "(1767225600.000000) vcan0 123#0011223344556677\n" * 4
MDF = b"MDF     4.10    asammdf ".ljust(512, b"\0")
FLEET = "--database sqlite:///fleet.sqlite"
OF_THE_FLEET = {f"{one} {FLEET}": "page" for one in ("serve", "watch")}
ASKED: Mapping[str, Mapping[str, str]] = {  # words, and the extra that they lack; empty: none
    "ecu-emulator": {"record made.mf4": "mf4", "scenarios": ""},
    "diag-service": {
        "dtc -i virtual -c x --active --description car.pdx": "odx,uds",
        "decode drive.log -o d.parquet": "parquet",
        "decode drive.log -o -": "parquet",
        "analyze drive.log -o a.parquet": "parquet",
        "lake check .": "cluster",
        "analyze . --lake lake": "cluster",
        **dict.fromkeys((f"{one} drive.mf4" for one in ("inspect", "signals", "analyze")), "mf4"),
        "calibrate drive.mf4 -o c.toml": "mf4",
        **dict.fromkeys((f"{one} drive.log" for one in ("inspect", "signals", "analyze")), ""),
        "config check": "",
    },
    "fleet-backend": {f"migrate {FLEET}": "", **OF_THE_FLEET, f"ingest {FLEET} --broker nats://127.0.0.1": "nats"},
}
LEFT_OUT = "analyze logs --jobs 1"  # a folder with a log that needs an extra


@pytest.fixture(name="plain", scope="module")
def _plain(tmp_path_factory: pytest.TempPathFactory) -> PlainInstall:
    return plain_install(tmp_path_factory.mktemp("plain"))


def one_line(program: str, extra: str, text: str) -> None:
    """Hold a complaint against what every complaint of this kind is."""
    assert re.fullmatch(rf"{program}: error: .*pip install '\.(?:/\w+)?\[{extra}\]' in the checkout\n", text), text


@pytest.mark.parametrize("program", MODULES)
def test_a_program_without_extras_helps_works_and_says_what_it_lacks(
    plain: PlainInstall, tmp_path: Path, program: str
) -> None:
    """One start for all words of a program."""
    (tmp_path / "drive.log").write_text(CANDUMP, encoding="utf-8")
    (tmp_path / "logs").mkdir()
    for place in ("drive.mf4", "logs/drive.mf4"):
        (tmp_path / place).write_bytes(MDF)
    helps = [f"{command} --help" for command in COMMANDS[program]]
    runs = ["--version", "--help", *helps, *ASKED[program], *([LEFT_OUT] if program == "diag-service" else [])]
    outcomes = plain.run_all(f"{MODULES[program]}.cli", [words.split() for words in runs], cwd=tmp_path)
    told: dict[str, Outcome] = dict(zip(runs, outcomes, strict=True))
    assert told["--version"].out.startswith(f"{program} ")
    assert re.search(r"2 usage[^;0-9]* or an extra that is not installed", " ".join(told["--help"].out.split()))
    for words in helps:
        assert (told[words].status, told[words].err) == (0, ""), words
        assert told[words].out.startswith(f"Usage: {program} {words.split()[0]} "), words
    for words, extra in ASKED[program].items():
        assert told[words].status == (2 if extra else 0), (words, told[words])
        assert "Traceback" not in told[words].err
        if extra:
            one_line(program, extra, told[words].err.splitlines(keepends=True)[-1])
    if LEFT_OUT in told:
        assert told[LEFT_OUT].status == 3
        assert "drive.mf4: not read: " in told[LEFT_OUT].out
        assert "pip install './canlog[mf4]'" in told[LEFT_OUT].err
    made = {"fleet.sqlite"} if program == "fleet-backend" else set()
    assert {path.name for path in tmp_path.iterdir()} == {"drive.log", "logs", "drive.mf4", *made}


def test_python_says_what_to_install(plain: PlainInstall, tmp_path: Path) -> None:
    (tmp_path / "drive.log").write_text(CANDUMP, encoding="utf-8")
    modules = sorted(extra_modules())
    assert {"starlette", "nats", "isotp", "pyarrow", "asammdf", "amqtt"} <= set(modules)
    program = f"""
import importlib.util
print([name for name in {modules} if importlib.util.find_spec(name)])
import diag_service, ecu_emulator, workshop
for package in (diag_service, ecu_emulator):
    for name in package.__all__:
        getattr(package, name)
analysis, log = diag_service.analyze("drive.log"), diag_service.read("drive.log")
for wanted in (
    analysis.shifts.to_arrow, analysis.shifts.to_pandas, analysis.clutches.to_polars, log.to_arrow,
    lambda: ecu_emulator.Emulator().record("drive.mf4"),
    workshop.UdsTester(interface="virtual", channel="1", is_active=True).__enter__,
    lambda: workshop.scan_controllers(interface="virtual", channel="1", is_active=True),
):
    try:
        wanted()
    except (diag_service.ExtraMissingError, ecu_emulator.LogFormatExtraError) as error:
        print(str(error).rpartition("pip install ")[2])
"""
    told = plain.run("-c", program, cwd=tmp_path)
    extras = ["./canlog[parquet]", None, None, "./canlog[parquet]", ".[mf4]", "./workshop[uds]", "./workshop[uds]"]
    names = ["", "pandas", "polars", "", "", "", ""]
    wanted = [f"'{extra}' in the checkout" if extra else name for extra, name in zip(extras, names, strict=True)]
    assert told.out.splitlines() == ["[]", *wanted], told.err
