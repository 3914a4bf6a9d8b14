"""The bill of materials names every package of the lock, with its version and hashes."""

import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_bill_is_the_lock() -> None:
    made = subprocess.run([sys.executable, ".ci/sbom.py"], cwd=ROOT, check=True, capture_output=True, text=True)
    bill = json.loads(made.stdout)
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.6")
    named = [(part["name"], part["version"]) for part in bill["components"]]
    assert named == re.findall(r"^([a-z0-9][a-z0-9._-]*)==([^ ]+)", lock, flags=re.MULTILINE)
    assert sum(len(part["hashes"]) for part in bill["components"]) == lock.count("--hash=sha256:")
    assert all(part["hashes"] for part in bill["components"])
    assert len({part["bom-ref"] for part in bill["components"]}) == len(named)


def test_the_bill_of_what_runs_names_licences_and_who_needs_what() -> None:
    made = subprocess.run(
        [sys.executable, ".ci/sbom.py", "--run-time"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    bill = json.loads(made.stdout)
    parts = {part["name"]: part for part in bill["components"]}
    assert {"numpy", "numba", "llvmlite", "cantools", "python-can", "click"} <= parts.keys()
    assert not {"pytest", "pyarrow", "asammdf", "sqlalchemy"} & parts.keys()  # of extras
    assert [name for name, part in parts.items() if not part.get("licenses")] == []
    references = {part["bom-ref"] for part in bill["components"]}
    for one in bill["dependencies"]:
        assert set(one["dependsOn"]) <= references
    assert {one["ref"] for one in bill["dependencies"]} - references == {bill["metadata"]["component"]["bom-ref"]}
