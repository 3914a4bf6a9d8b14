"""Writes what the cells of the notebook show into it: ``python -m tests.tools.notebook_outputs``.

They run in this process, one after the other in an empty folder, and show what Jupyter would show of them.
"""

import ast
import base64
import io
import json
from collections.abc import Iterator
from contextlib import chdir, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from matplotlib.figure import Figure

NOTEBOOK: Final = Path(__file__).parents[2] / "examples" / "notebook.ipynb"
Output = dict[str, Any]


def read() -> dict[str, Any]:
    notebook: dict[str, Any] = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    return notebook


def outputs_of(cells: list[dict[str, Any]], names: dict[str, Any]) -> Iterator[list[Output]]:
    """Run the cells in the working directory, and yield the outputs of each that is code; ``names`` are its variables.

    What an error raises is raised.
    """
    number = 0
    for cell in cells:
        if cell["cell_type"] != "code":
            continue
        number += 1
        source = "\n".join(line for line in "".join(cell["source"]).splitlines() if not line.startswith("%"))
        statements = ast.parse(source).body
        last = statements[-1]
        value = None
        with redirect_stdout(io.StringIO()) as said:
            if isinstance(last, ast.Expr):
                exec(compile(ast.Module(statements[:-1], []), cell["id"], "exec"), names)  # noqa: S102 - as a notebook does
                value = eval(compile(ast.Expression(last.value), cell["id"], "eval"), names)  # noqa: S307 - likewise
            else:
                exec(compile(ast.Module(statements, []), cell["id"], "exec"), names)  # noqa: S102 - likewise
        outputs: list[Output] = []
        if text := said.getvalue():
            outputs.append({"name": "stdout", "output_type": "stream", "text": text.splitlines(keepends=True)})
        if value is not None:
            shown = {"data": _shown(value), "metadata": {}}
            outputs.append({**shown, "execution_count": number, "output_type": "execute_result"})
        yield outputs


def _shown(value: object) -> dict[str, Any]:
    """Return a value as each kind of reader of a notebook takes it."""
    data: dict[str, Any] = {}
    if isinstance(value, Figure):
        picture = io.BytesIO()
        value.savefig(picture, format="png", dpi=80)
        return {
            "image/png": base64.b64encode(picture.getvalue()).decode(),
            "text/plain": [f"<Figure of {len(value.axes)} axes>"],
        }
    if hasattr(value, "_repr_html_"):
        data["text/html"] = value._repr_html_().splitlines(keepends=True)
    return {**data, "text/plain": repr(value).splitlines(keepends=True)}


def main() -> None:
    notebook = read()
    with TemporaryDirectory() as folder, chdir(folder):
        outputs = list(outputs_of(notebook["cells"], {}))
    codes = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for number, (cell, shown) in enumerate(zip(codes, outputs, strict=True), 1):
        cell["outputs"], cell["execution_count"] = shown, number
    text = json.dumps(notebook, indent=1, ensure_ascii=False, sort_keys=True)
    NOTEBOOK.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
