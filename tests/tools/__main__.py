"""All commands for people who change the project, with what each is for: ``python -m tests.tools [WORD...]``.

With words, those that have all of them in their name or first line.
"""

import ast
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = ("tests/tools", "tests/golden", "studies")


def commands() -> dict[str, str]:
    """Return the docstring of each module that can be called, by how it is called."""
    found = {}
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            if "\nif __name__ ==" in text:
                module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__main__")
                found[f"python -m {module}"] = ast.get_docstring(ast.parse(text)) or ""
    return found


def main(arguments: Sequence[str]) -> None:
    for command, said in commands().items():
        line = f"{command:<44} {' '.join(said.split(chr(10) * 2)[0].split())}"
        if all(word.lower() in line.lower() for word in arguments):
            print(line)


if __name__ == "__main__":
    main(sys.argv[1:])
