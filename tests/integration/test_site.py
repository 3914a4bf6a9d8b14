"""The documents as a site: every link leads somewhere, and what is made from the code is there."""

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.support.patience import HANG_S

ROOT = Path(__file__).parents[2]


def test_the_site_is_built_without_a_warning_and_can_be_searched(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)]
    quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(command, cwd=ROOT, env=quiet, capture_output=True, text=True, check=False, timeout=HANG_S)
    assert (built.returncode, built.stdout + built.stderr) == (0, "")
    found = json.loads((tmp_path / "search" / "search_index.json").read_text(encoding="utf-8"))["docs"]
    text = {one["location"]: one["text"] for one in found}
    assert any("diag-service-decode" in place for place in text)
    assert any(place.startswith("reference/canlog.html#canlog.read") for place in text)
    assert any(place.startswith("reference/tools.html#studies") for place in text)
    pages = [path.read_text(encoding="utf-8") for path in tmp_path.glob("*.html")]
    assert not any("https://fonts" in page or "cdn" in page for page in pages)  # it is read offline
