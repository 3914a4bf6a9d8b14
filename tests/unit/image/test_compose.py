"""The image and its compose file."""

import os
import re
import subprocess
import time
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

from tests.support.image.compose import Service, read_compose
from tests.support.image.context import context_files
from tests.support.image.dockerfile import Copy, read_stages

ROOT = Path(__file__).parents[3]
COMPOSE = read_compose(ROOT / "docker-compose.yml")
SERVICES: dict[str, Service] = COMPOSE["services"]
OURS = {name: service for name, service in SERVICES.items() if "build" in service}
LONGEST_START_S = 30
EXACT = re.compile(r"[a-z0-9./-]+:v?\d+\.\d+(\.\d+)?(-[a-z0-9-]+)?")


def each(services: dict[str, Service]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("service", services.values(), ids=services)


@each(SERVICES)
def test_it_has_a_health_check_or_ends_by_itself(service: Service) -> None:
    check = service["healthcheck"]
    if check.get("disable"):
        assert service["restart"] == "no"
        waiting = [other for other in SERVICES.values() if service is not other and "depends_on" in other]
        name = next(key for key, value in SERVICES.items() if value is service)
        conditions = {other["depends_on"][name]["condition"] for other in waiting if name in other["depends_on"]}
        assert conditions == {"service_completed_successfully"}
        return
    assert check["test"][0] in {"CMD", "CMD-SHELL"}
    assert {"interval", "timeout", "retries"} <= set(check)
    assert int(check.get("start_period", "0s").removesuffix("s")) <= LONGEST_START_S


def test_images_have_exact_tags() -> None:
    images = [service["image"] for service in SERVICES.values()]
    images += [stage.image for stage in read_stages(ROOT / "Dockerfile")]
    assert [name for name in images if EXACT.fullmatch(name) is None] == []


@each(OURS)
def test_its_command_is_understood(service: Service, capsys: pytest.CaptureFixture[str]) -> None:
    program, command, *words = service["command"]
    main = import_module(f"{program.replace('-', '_')}.cli").main
    assert main([command, "--help"]) == 0
    known = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", capsys.readouterr().out))
    assert {word for word in words if word.startswith("-")} - known == set()


@pytest.mark.parametrize(("age_s", "is_well"), [(0.0, True), (20.0, True), (60.0, False), (None, False)])
@pytest.mark.parametrize("name", ["emulator", "ingest"])
def test_a_file_that_grows_old_is_not_well(name: str, age_s: float | None, tmp_path: Path, *, is_well: bool) -> None:
    kind, text = SERVICES[name]["healthcheck"]["test"]
    assert kind == "CMD-SHELL"
    inside = SERVICES[name]["command"][SERVICES[name]["command"].index("--alive") + 1]
    assert inside in text
    path = tmp_path / "alive"
    if age_s is not None:
        path.touch()
        os.utime(path, (time.time() - age_s,) * 2)
    done = subprocess.run(["/bin/sh", "-c", text.replace(inside, str(path))], capture_output=True, check=False)
    assert (done.returncode == 0) == is_well


STAGES = read_stages(ROOT / "Dockerfile")
COPIES = [copy for stage in STAGES for copy in stage.copies if copy.stage is None]


@cache
def context() -> list[str]:
    """Return the files of the build context."""
    return list(context_files(ROOT))


@pytest.mark.parametrize("copy", COPIES, ids=lambda copy: copy.target)
def test_what_the_dockerfile_copies_is_in_the_context(copy: Copy) -> None:
    missing = [name for name in copy.sources if not any(f"{file}/".startswith(f"{name}/") for file in context())]
    assert missing == []


def test_the_context_has_nothing_that_the_dockerfile_does_not_copy() -> None:
    wanted = [name for copy in COPIES for name in copy.sources]
    assert [file for file in context() if not any(f"{file}/".startswith(f"{name}/") for name in wanted)] == []
