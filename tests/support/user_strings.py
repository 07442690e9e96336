"""List every string that users see, to read them in one go: python tests/support/user_strings.py [folder].

Docstrings, raised errors, what commands print, notes, verdicts and help texts: all string literals of five words or
more, with their place; the fields of f-strings as {}.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
WORDS = 5


def strings(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of the strings of a Python file, docstrings included; pieces of an f-string as one."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inner = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts = (part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
            yield node.lineno, "".join(map(str, parts))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inner:
            yield node.lineno, node.value


def main(folder: Path) -> None:
    """Print them."""
    for path in sorted(folder.rglob("*.py")):
        for line, text in sorted(strings(path)):
            if len(text.split()) >= WORDS:
                print(f"{path.relative_to(ROOT)}:{line}: {' '.join(text.split())}")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else ROOT / "src")
