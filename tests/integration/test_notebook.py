"""The notebook runs from its first cell to its last.

Its cells run in this process: a kernel of its own, with what it takes to talk to it, costs more than all that they do.
"""

import json
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from diag_service import Analysis
from tests.support.documents import ROOT

NOTEBOOK = ROOT / "examples" / "notebook.ipynb"


def cells() -> list[dict[str, Any]]:
    notebook: dict[str, Any] = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    found: list[dict[str, Any]] = notebook["cells"]
    return found


def test_it_is_stored_without_outputs_and_with_names_of_cells() -> None:
    names = [cell["id"] for cell in cells()]
    assert len(names) == len(set(names))
    for cell in cells():
        keys = {"cell_type", "id", "metadata", "source"}
        is_code = cell["cell_type"] == "code"
        assert set(cell) == keys | ({"execution_count", "outputs"} if is_code else set())
        assert not is_code or (cell["outputs"], cell["execution_count"]) == ([], None)


def test_its_cells_run_in_their_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    shown: list[object] = []
    for cell in cells():
        if cell["cell_type"] == "code":
            *body, last = [line for line in "".join(cell["source"]).splitlines() if not line.startswith("%")]
            is_value = last.isidentifier() or last.endswith(("()", "]")) or last == "made.totals"
            exec("\n".join(body if is_value else [*body, last]), names)  # noqa: S102 - what a notebook is for
            if is_value:
                shown.append(eval(last, names))  # noqa: S307 - likewise
    assert len(names["analysis"].results) == 10
    assert [type(one) for one in shown if isinstance(one, Analysis | Figure)] == [Analysis, Figure]
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 2
    for line in said:  # each clutch, against the truth
        assert abs(float(line.split(", ")[-1].split()[0])) < 3.0, line
