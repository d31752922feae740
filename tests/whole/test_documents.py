"""README and docs: every command, key and name that they show exists; tutorials as notebooks."""

import ast
import inspect
import json
import re
import shlex
from pathlib import Path
from typing import Any

import measure
import pages
import pytest
import random_runs
import typer
from pydantic import BaseModel

import signorini_fenicsx.api
from signorini_fenicsx import extend
from signorini_fenicsx.cases.complaints import keys_of
from signorini_fenicsx.cases.pairs import LawTexts
from signorini_fenicsx.cases.quantities import QuantityTexts
from signorini_fenicsx.cli.app import app
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.elasticity.case import ContactTexts, ElasticCase
from signorini_fenicsx.physics.stokes.case import FlowLaw, StokesCase

PUBLIC = {"signorini_fenicsx": signorini_fenicsx, "signorini_fenicsx.extend": extend}
ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"```\{?(sh|toml|python|code-cell)\b[^\n]*\n(.*?)```", re.DOTALL)


def blocks(kind: str) -> list[tuple[Path, str]]:
    """The blocks of a kind, with their pages."""
    return [(page, text) for page in PAGES for name, text in BLOCK.findall(page.read_text("utf-8")) if name == kind]


def commands() -> list[str]:
    """Each command of the program that a page shows, in a block or within a sentence."""
    lines = [line for _, text in blocks("sh") for line in text.splitlines()]
    for page in PAGES:
        lines += re.findall(
            r"`((?:uv run )?signorini [^`]+)`", re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL)
        )
    shown = [re.search(r"(?:^|run |-n \d )signorini (\w.*)", " ".join(line.split(" #")[0].split())) for line in lines]
    return sorted({match[1] for match in shown if match})


@pytest.mark.parametrize("command", commands())
def test_commands(command: str):
    """The program has the command, and it takes the options; nothing runs."""
    name, *arguments = shlex.split(command.split(" -- ")[0])
    program = typer.main.get_command(app)
    program.commands[name].make_context(name, arguments, resilient_parsing=not arguments)


def test_keys_of_case_files():
    """Each key that a page shows in a case file is one of a case, also those behind `# `."""
    models = [definition for model in (Case, ElasticCase, StokesCase) for definition in schemas(model)]
    known = {name for definition in models for name in definition.get("properties", {})}
    known |= {
        key
        for model in (LawTexts, ContactTexts, FlowLaw, QuantityTexts)
        for own in model.of_kind.values()
        for key in keys_of(own)
    }
    for page, text in blocks("toml"):
        if re.search(r"\[(problem|boundary|dam)\]", text):
            shown = set(re.findall(r"(?m)^(?:# )?(\w+) = ", text))
            assert shown - known == set(), page


def schemas(model: type[BaseModel]) -> list[dict[str, Any]]:
    """The JSON schemas of a model and of its parts."""
    schema = model.model_json_schema()
    return [schema, *schema["$defs"].values()]


def test_scripts_that_pages_name():
    """Each script is there, and knows what a page asks it for."""
    found = re.compile(r"scripts/(\w+)\.py(?: ([a-zA-Z][\w-]*))?")
    named = {pair for page in PAGES for pair in found.findall(page.read_text("utf-8"))}
    assert [name for name, _ in named if not (ROOT / "scripts" / f"{name}.py").is_file()] == []
    known = {"measure": measure.MODULES, "pages": pages.COMMANDS, "random_runs": random_runs.KINDS}
    assert [(name, what) for name, what in named if what and what not in known.get(name, (what,))] == []


def test_names_in_python():
    """Blocks of Python can be parsed; the names that they import exist, and the keywords of calls are known."""
    for page, text in blocks("python") + blocks("code-cell"):
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and node.module in PUBLIC:
                assert [alias.name for alias in node.names if alias.name not in dir(PUBLIC[node.module])] == [], page
            name = getattr(getattr(node, "func", None), "id", "")
            if isinstance(node, ast.Call) and name in signorini_fenicsx.__all__:
                signature = inspect.signature(getattr(signorini_fenicsx, name))
                given = {keyword.arg for keyword in node.keywords if keyword.arg}
                open_ended = any(each.kind == each.VAR_KEYWORD for each in signature.parameters.values())
                assert open_ended or given <= set(signature.parameters), f"{page.name}: {name} {given}"


def test_the_reference_has_every_name():
    """What can be imported from the package is in `docs/code/api.md`."""
    reference = (ROOT / "docs" / "code" / "api.md").read_text("utf-8")
    shown = set(re.findall(r"(?m)^\.\. auto\w+:: (?:[\w.]*\.)?(\w+)$", reference))
    assert set(signorini_fenicsx.api.__all__) - shown == set()


def test_each_file_of_tests_has_its_line():
    """The page on tests has one line for each file: the first line of its docstring."""
    page = (ROOT / "docs" / "code" / "tests.md").read_text(encoding="utf-8")
    lines = dict(re.findall(r"^\| `(\w+/test_\w+\.py)` \| (.*) \|$", page, flags=re.MULTILINE))
    files = {path: path.read_text(encoding="utf-8").splitlines()[0] for path in (ROOT / "tests").glob("*/test_*.py")}
    assert lines == {f"{path.parent.name}/{path.name}": first.strip('"') for path, first in files.items()}


def test_files_and_names_of_the_layout_exist():
    """A file alone belongs in a row of a table to the folder named last before it; elsewhere any folder will do."""
    roots = [ROOT / "signorini_fenicsx", ROOT]
    files = {path.name for root in ("signorini_fenicsx", "forms") for path in (ROOT / root).rglob("*.py")}
    named, lost, layout = 0, [], (ROOT / "docs" / "code" / "layout.md").read_text(encoding="utf-8")
    for line in layout.splitlines():
        folder = ""
        for name in re.findall(r"`([\w*/]+(?:\.py|/))`", line):
            named, path = named + 1, name if "/" in name else f"{folder}{name}"
            folder = path[: path.rfind("/") + 1] if line.startswith("|") else ""
            if not (any(list(root.glob(path)) for root in roots) or ("/" not in path and name in files)):
                lost.append(path)
    texts = [path.read_text("utf-8") for root in ("signorini_fenicsx", "forms") for path in (ROOT / root).rglob("*.py")]
    words = set(re.findall(r"\w+", "".join(texts)))
    assert lost + [name for name in re.findall(r"`(\w+)`", layout) if name not in words] == []
    assert named > 100


def test_modules_that_docstrings_name():
    """A dotted name in backquotes that begins with a folder of the package is a module there, or in one."""
    package = ROOT / "signorini_fenicsx"
    paths = [*package.rglob("*.py"), *(package / "forms").glob("*.py")]  # the forms are a link there
    texts = {path.relative_to(package).with_suffix("").parts: path.read_text("utf-8") for path in paths}
    named = {(path[-1], name) for path, text in texts.items() for name in re.findall(r"`([a-z]\w+(?:\.\w+)+)`", text)}
    lost = []
    for where, name in named:
        words = tuple(name.split("."))
        if (package / words[0]).is_dir() and words[-1] not in ("csv", "png"):
            known = next(number for number in range(len(words), 0, -1) if (package.joinpath(*words[:number])).is_dir())
            known += words[: known + 1] in texts
            module = texts.get(words[:known], texts.get((*words[:known], "__init__"), ""))
            if known < len(words) and not re.search(rf"\b{words[known]}\b", module):
                lost.append(f"{where}: {name}")
    assert lost == []


def test_notebooks(tmp_path: Path):
    """Each tutorial is a notebook with all its code, as Jupyter's format wants it; the documentation runs the code."""
    for path in pages.notebooks(tmp_path):
        page = (ROOT / "docs" / "tutorials" / f"{path.stem}.md").read_text("utf-8")
        cells = json.loads(path.read_text("utf-8"))["cells"]
        codes = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
        assert codes == [text.strip("\n") for kind, text in BLOCK.findall(page) if kind == "code-cell"]
        assert not any("../" in code for code in codes), "a notebook runs in any folder"
        assert all(not {".md)", "../static"} & set(re.findall(r"\.md\)|\.\./static", str(cell))) for cell in cells)
    nbformat = pytest.importorskip("nbformat")
    nbformat.validate(nbformat.read(tmp_path / "hertz.ipynb", 4))
