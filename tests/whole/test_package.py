"""The installed package, what a run imports, circles of imports, and the sizes of modules and functions."""

import importlib.metadata
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import grimp
import numpy as np
import pytest
import scipy.sparse.csgraph
from mpi4py import MPI
from sizes import too_long

import signorini_fenicsx
from signorini_fenicsx import api
from signorini_fenicsx.cli import main, start

ROOT = Path(__file__).parents[2]


def test_every_room_is_installed():
    """The list in pyproject.toml is complete, and an installation adds only one name, that of the package."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        packages = tomllib.load(file)["tool"]["setuptools"]["packages"]
    folders = [path.parent.relative_to(ROOT) for path in (ROOT / "signorini_fenicsx").rglob("__init__.py")]
    assert sorted({".".join(folder.parts) for folder in folders} | {"signorini_fenicsx.forms"}) == sorted(packages)
    assert importlib.metadata.distribution("signorini_fenicsx").read_text("top_level.txt") == "signorini_fenicsx\n"


def python(folder: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python as in a shell."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith(("PMI", "HYDI", "MPI", "PYTHON"))}
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=plain | environment, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("first", ["mpi4py.MPI", "signorini_fenicsx"])
def test_what_may_be_imported_before_dolfinx(tmp_path: Path, first: str):
    done = python(tmp_path, "-c", f"import {first}, dolfinx.fem.petsc")
    assert (done.returncode, done.stderr) == (0, "")


def test_nothing_is_put_into_the_start_of_python():
    files = importlib.metadata.files("signorini_fenicsx") or []
    assert [str(file) for file in files if file.suffix == ".pth" and "__editable__" not in file.name] == []


def test_the_low_level_of_dolfinx_is_in_one_file():
    """What other versions of DOLFINx change is named in `base/fenicsx.py` alone."""
    names = r"create_mesh\b|partitioner|create_submesh|(?<!model\.)mesh\.refine\b|ffcx\b|dolfinx\.jit"
    names += r"|fem\.form\(|fem\.functionspace\("
    found = {
        path.relative_to(ROOT / "signorini_fenicsx").as_posix()
        for path in (ROOT / "signorini_fenicsx").rglob("*.py")
        if re.search(names, re.sub(r"(?m)^>>> .*$|^\s+>>> .*$", "", path.read_text(encoding="utf-8")))
    }
    assert found == {"base/fenicsx.py"}


def test_modules_are_not_imported_by_text():
    """Lint sees all imports, but for the lazy names of the package, and what a confined process is told to run."""
    files = (ROOT / "signorini_fenicsx").rglob("*.py")
    found = {path.name for path in files if "import_module(" in path.read_text(encoding="utf-8")}
    assert found == {"__init__.py", "confined.py"}


def test_nothing_is_loaded_before_it_is_used(tmp_path: Path):
    loaded = "[name for name in ('mpi4py', 'numpy', 'dolfinx') if name in sys.modules]"
    done = python(tmp_path, "-c", f"import sys, signorini_fenicsx; print({loaded})")
    assert (done.stdout, done.stderr) == ("[]\n", "")


RUN = """
import sys
from signorini_fenicsx.cli import main
sys.argv = ["signorini", "solve", "{case}", "--h", "{h}", "--quiet"]
try:
    main.main()
except SystemExit:
    loaded = [name for name in sys.modules if name.startswith("signorini_fenicsx")]
    print([name for name in loaded if any(other in name for other in {others})], "scipy" in sys.modules)
"""


@pytest.mark.parametrize(
    ("case", "h", "others"),
    [("example1", "0.5", ["elastic", "stokes"]), ("plate", "0.02", ["diffusion", "stokes"])],
)
def test_a_run_imports_nothing_of_another_physics_and_no_scipy(tmp_path: Path, case: str, h: str, others: list[str]):
    done = python(tmp_path, "-c", RUN.format(case=case, h=h, others=others))
    assert (done.stdout, done.stderr) == ("[] False\n", "")
    assert (tmp_path / "results" / case / "summary.json").is_file()


def test_circles_of_imports_are_within_one_part():
    """Late imports and those for types alone count as well: nothing but what is in one physics or folder is tied."""
    graph = grimp.build_graph("signorini_fenicsx", cache_dir=None)
    names = sorted(graph.modules)
    place = {name: row for row, name in enumerate(names)}
    pairs = [(place[name], place[other]) for name in names for other in graph.find_modules_directly_imported_by(name)]
    ties = scipy.sparse.coo_array((np.ones(len(pairs)), tuple(zip(*pairs, strict=True))), shape=(len(names),) * 2)
    number, circle = scipy.sparse.csgraph.connected_components(ties, directed=True, connection="strong")
    circles = [[name.split(".") for name, of in zip(names, circle, strict=True) if of == k] for k in range(number)]
    parts = [{tuple(name[1:3] if name[1:2] == ["physics"] else name[1:2]) for name in each} for each in circles]
    assert [each for each in parts if len(each) > 1] == []


def test_a_process_that_reads_a_mesh_loads_no_dolfinx(tmp_path: Path):
    """A confined process, one for each mesh file, starts without what takes longer to load than Gmsh."""
    heavy = "('mpi4py', 'dolfinx', 'ufl', 'scipy', 'meshio', 'gmsh')"
    loaded = f"print(*(name for name in {heavy} if name in sys.modules))"
    readers = (f"signorini_fenicsx.meshes.{name}" for name in ("file_worker", "gmsh_worker", "meshio_files"))
    code = "; ".join(f"import {reader}; {loaded}" for reader in readers)
    done = python(tmp_path, "-c", f"import sys; {code}")
    assert (done.stdout.splitlines(), done.stderr) == (["", "gmsh", "meshio gmsh"], "")


def test_names_of_the_package():
    assert signorini_fenicsx.__all__ == api.__all__
    assert all(getattr(signorini_fenicsx, name) is getattr(api, name) for name in api.__all__)
    assert {*api.__all__, "extend", "__doc__", "__version__"} == set(dir(signorini_fenicsx))
    assert {name for name in api.__all__ if not re.search(rf"`{name}\b", str(signorini_fenicsx.__doc__))} == set()
    with pytest.raises(AttributeError, match="has no attribute 'slove'"):
        signorini_fenicsx.slove  # noqa: B018 - that is the test


def test_without_dolfinx(tmp_path: Path):
    """Without site-packages there is no DOLFINx: one sentence, not a traceback."""
    command = "from signorini_fenicsx.cli.start import main; main()"
    done = python(tmp_path, "-S", "-c", command, PYTHONPATH=str(ROOT))
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: DOLFINx is not installed")
    assert done.stderr.count("\n") == 1


@pytest.mark.parallel([1, 2])
def test_ranks_have_one_thread_each(monkeypatch: pytest.MonkeyPatch):
    """On several ranks the command sets OMP_NUM_THREADS where the user did not; on one all cores are free."""
    monkeypatch.setattr(main, "main", lambda: None)
    monkeypatch.setattr("signal.signal", lambda *_: None)  # those of the test stay
    for given in (None, "3"):
        monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
        if given is not None:
            monkeypatch.setenv("OMP_NUM_THREADS", given)
        start.main()
        assert os.environ.get("OMP_NUM_THREADS") == (given or ("1" if MPI.COMM_WORLD.size > 1 else None))


def test_files_that_the_documentation_names():
    """Each `….py` in README and docs is a file, by its name and the folder before it if one is named."""
    folders = ("data", "forms", "scripts", "signorini_fenicsx", "tests")
    files = {path.parts[-2:] for folder in folders for path in (ROOT / folder).rglob("*.py")}
    known = {f"{folder}/{name}" for folder, name in files} | {name for _, name in files}
    for page in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")):
        named = set(re.findall(r"(?:\w+/)?\w+\.py\b", page.read_text(encoding="utf-8")))
        assert named - known == set(), page


def test_fractions_have_braces():
    r"""Docutils reads the 12 in \tfrac12 as one number, and the next character as the denominator."""
    for page in (ROOT / "docs").rglob("*.md"):
        assert re.findall(r"frac\d\d", page.read_text(encoding="utf-8")) == [], page


def test_gallery_and_pictures():
    """The gallery has all shipped cases with their titles, and committed pictures are small."""
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    for path in (ROOT / "data" / "cases").glob("*.toml"):
        title = tomllib.loads(path.read_text(encoding="utf-8"))["title"]
        assert f"<br>**{path.stem}**: {title}" in page
        assert f"(static/gallery/{path.stem}.png)" in page
    for path in (ROOT / "docs" / "static").rglob("*.png"):
        assert path.stat().st_size <= 300_000, path


def test_readme_is_short_and_its_links_lead_somewhere():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert readme.count("\n") <= 120
    assert [link for link in re.findall(r"\]\((docs/[^)]+)\)", readme) if not (ROOT / link).is_file()] == []


def test_the_paper_cites_what_it_lists():
    """And the links of CONTRIBUTING.md lead somewhere."""
    cited = set(re.findall(r"@(\w+)", (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")))
    entries = re.findall(r"@\w+\{(\w+),", (ROOT / "docs" / "paper.bib").read_text(encoding="utf-8"))
    assert sorted(entries) == sorted(cited)
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\((?!http)([^)#]+)(?:#([^)]+))?\)", contributing)
    for path, anchor in links:
        text = (ROOT / path).read_text(encoding="utf-8")
        titles = [title.lower().replace("'", "").replace(" ", "-") for title in re.findall(r"(?m)^#+ (.*)$", text)]
        assert not anchor or anchor in titles, anchor


@pytest.mark.parametrize(
    ("file", "text", "found"),
    [
        ("forms/a.py", "x = 1\n" * 450, []),
        ("forms/a.py", "x = 1\n" * 451, ["forms/a.py: 451 lines, more than 450"]),
        ("tests/a.py", "x = 1\n" * 451, ["tests/a.py: 451 lines, more than 450"]),
        ("forms/a.py", 'def f():\n    """One.\n\n    Two.\n    """\n' + "    g()\n" * 50, []),
        ("forms/a.py", "def f():\n" + "    g()\n" * 51, ["forms/a.py:1: f has a body of 51 lines, more than 50"]),
        ("scripts/a.py", "def f():\n" + "    g()\n" * 60, []),
    ],
)
def test_sizes(tmp_path: Path, file: str, text: str, found: list[str]):
    path = tmp_path / file
    path.parent.mkdir()
    path.write_text(text)
    assert list(too_long(tmp_path)) == found


@pytest.mark.parametrize("script", sorted((ROOT / "scripts").glob("*.py")), ids=lambda path: path.stem)
def test_scripts_load_the_wheels_libraries_first(script: Path):
    """With the wheel, DOLFINx is found after this package or mpi4py has been imported."""
    text = script.read_text(encoding="utf-8")
    first = re.search(r"(?m)^(?:import|from) (dolfinx|mpi4py|petsc4py|signorini_fenicsx)\b", text)
    if "__main__" in text and first is not None:
        assert first[1] in ("mpi4py", "signorini_fenicsx")
