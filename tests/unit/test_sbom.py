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
