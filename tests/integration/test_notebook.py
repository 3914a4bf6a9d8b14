"""The notebook runs from its first cell to its last, and the outputs that it is stored with are those of today.

Its cells run in this process: a kernel of its own, with what it takes to talk to it, costs more than all that they do.
"""

import base64
import re
from pathlib import Path
from typing import Any

import pytest

from tests.tools.notebook_outputs import Output, outputs_of, read

NUMBER = re.compile(r"[-+]?\d[\d.,]*(e[-+]?\d+)?")
MOST_BYTES = 300_000  # of what is stored


def code_cells() -> list[dict[str, Any]]:
    return [cell for cell in read()["cells"] if cell["cell_type"] == "code"]


def shape_of(output: Output) -> dict[str, str]:
    """Return what an output shows, by kind, with ``#`` for numbers; of a picture its kind alone."""
    if output["output_type"] == "stream":
        return {output["name"]: NUMBER.sub("#", "".join(output["text"]))}
    data = output["data"]
    texts = {kind: NUMBER.sub("#", "".join(text)) for kind, text in data.items() if not kind.startswith("image/")}
    # A table is as wide as its numbers.
    return {kind: re.sub(r"[ \n]+", " ", text) for kind, text in texts.items()} | dict.fromkeys(data.keys() - texts, "")


def test_it_is_a_notebook_of_named_cells_with_an_output_for_each_that_shows_something() -> None:
    notebook = read()
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    names = [cell["id"] for cell in notebook["cells"]]
    assert len(names) == len(set(names))
    for cell in notebook["cells"]:
        keys = {"cell_type", "id", "metadata", "source"}
        assert set(cell) == keys | ({"execution_count", "outputs"} if cell["cell_type"] == "code" else set())
    codes = code_cells()
    assert [cell["execution_count"] for cell in codes] == list(range(1, len(codes) + 1))
    assert all(cell["outputs"] for cell in codes)
    assert len(str(notebook)) < MOST_BYTES


def test_what_it_shows_is_what_its_cells_show_now(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are written anew by ``python -m tests.tools.notebook_outputs``."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    shown = list(outputs_of(read()["cells"], names))
    assert len(names["analysis"].results) == 10
    stored = [cell["outputs"] for cell in code_cells()]
    assert [list(map(shape_of, outputs)) for outputs in stored] == [list(map(shape_of, outputs)) for outputs in shown]
    (*_, (picture,)) = stored
    assert base64.b64decode(picture["data"]["image/png"]).startswith(b"\x89PNG")
    for outputs in (stored, shown):
        (lines,) = (one["text"] for many in outputs for one in many if one["output_type"] == "stream")
        assert len(lines) == 2
        for line in lines:  # each clutch, against the truth
            assert abs(float(line.split(", ")[-1].split()[0])) < 3.0, line
