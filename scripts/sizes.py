"""Refuses modules and functions that are too long: `python scripts/sizes.py`, a part of CI.

Of a function its body counts, without its docstring.
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODULE = {"forms": 450, "signorini_fenicsx": 450, "scripts": 450, "tests": 450}
"""Most lines of a module, by folder."""
FUNCTION = 50
"""Most lines of the body of a function in the package and its forms."""


def too_long(root: Path) -> Iterator[str]:
    """One sentence for each module and function in the repository at `root` that is too long."""
    for folder, most in MODULE.items():
        for path in sorted((root / folder).rglob("*.py")):
            name, text = path.relative_to(root), path.read_text(encoding="utf-8")
            if (lines := len(text.splitlines())) > most:
                yield f"{name}: {lines} lines, more than {most}"
            if folder in ("forms", "signorini_fenicsx"):
                for node in ast.walk(ast.parse(text)):
                    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and (lines := length(node)) > FUNCTION:
                        yield f"{name}:{node.lineno}: {node.name} has a body of {lines} lines, more than {FUNCTION}"


def length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of the body of a function without its docstring."""
    first, *rest = function.body
    begin = first if ast.get_docstring(function, clean=False) is None else next(iter(rest), None)
    return 0 if begin is None else (function.end_lineno or 0) - begin.lineno + 1


if __name__ == "__main__":
    found = list(too_long(ROOT))
    print("\n".join(found), end="\n" if found else "")
    sys.exit(bool(found))
