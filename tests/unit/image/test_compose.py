"""Every service of docker-compose.yml says when it is well, what it may use and how much of its log is kept."""

import json
import os
import re
import subprocess
import time
from importlib import import_module
from pathlib import Path

import pytest

from tests.support.image.compose import Service, read_compose
from tests.support.image.dockerfile import read_stages

ROOT = Path(__file__).parents[3]
COMPOSE = read_compose(ROOT / "docker-compose.yml")
SERVICES: dict[str, Service] = COMPOSE["services"]
OURS = {name: service for name, service in SERVICES.items() if "build" in service}
LAST = read_stages(ROOT / "Dockerfile")[-1]
EXACT = re.compile(r"[a-z0-9./-]+:v?\d+\.\d+(\.\d+)?(-[a-z0-9-]+)?")
MIB = {"M": 1, "G": 1024}


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


@each(SERVICES)
def test_it_has_limits(service: Service) -> None:
    limits = service["deploy"]["resources"]["limits"]
    size = re.fullmatch(r"(\d+)([MG])", limits["memory"])
    assert size is not None
    assert 64 <= int(size[1]) * MIB[size[2]] <= 2048
    assert 0.0 < float(limits["cpus"]) <= 1.0  # an engine refuses more than the host has
    assert 16 <= limits["pids"] <= 1024


@each(SERVICES)
def test_its_log_is_bounded(service: Service) -> None:
    assert service["logging"]["driver"] == "json-file"
    options = service["logging"]["options"]
    assert re.fullmatch(r"\d+m", options["max-size"])
    assert 1 <= int(options["max-file"]) <= 10


def test_images_have_exact_tags() -> None:
    images = [service["image"] for service in SERVICES.values()]
    images += [stage.image for stage in read_stages(ROOT / "Dockerfile")]
    assert [name for name in images if EXACT.fullmatch(name) is None] == []


def test_compiled_kernels_outlive_the_containers_that_use_them() -> None:
    folder = LAST.environment["NUMBA_CACHE_DIR"]
    for name in ("service", "emulator"):
        mounts = dict(volume.split(":") for volume in SERVICES[name]["volumes"])
        (volume,) = [source for source, target in mounts.items() if target == folder]
        assert volume in COMPOSE["volumes"]


def test_results_are_kept_where_the_image_writes_them() -> None:
    targets = [volume.split(":")[1] for volume in SERVICES["service"]["volumes"]]
    assert f"{LAST.environment['XDG_STATE_HOME']}/clutchdiag" in targets


@each(OURS)
def test_its_command_is_understood(service: Service, capsys: pytest.CaptureFixture[str]) -> None:
    program, command, *words = service["command"]
    main = import_module(f"{program.replace('-', '_')}.cli").main
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
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


def test_the_services_health_check_asks_where_it_serves() -> None:
    command = SERVICES["service"]["command"]
    address = command[command.index("--metrics") + 1]
    assert f"http://{address}/readyz" in json.dumps(SERVICES["service"]["healthcheck"]["test"])
