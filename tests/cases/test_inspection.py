"""Inspection of a case before it is solved, output for programs, and broken case files: one sentence each."""

import json
import os
import random
import re
import subprocess
import sys
from pathlib import Path

import pytest
from broken_input import write_broken_case
from commands import signorini
from mpi4py import MPI

from signorini_fenicsx import InputError, load_case, solve_case
from signorini_fenicsx.base.shipped import case_names
from signorini_fenicsx.cases.inspection import check, expected
from signorini_fenicsx.cli.main import main


def test_sizes_are_those_of_the_mesh():
    """Sizes are exact for mesh files, estimates for shapes; the parts have their conditions and measures."""
    for name, tolerance in (("dam", 0), ("electropainting", 0), ("example2", 0.25), ("cube", 0.35)):
        case = load_case(name)
        case = case if case.geometry.file else case.with_values({"solve.h": 0.2})
        estimate, counts = expected(case, 1), check(case, MPI.COMM_SELF).counts
        assert estimate.exact == (tolerance == 0)
        assert estimate.cells == pytest.approx(counts["cells"], rel=tolerance)
    dam = expected(load_case("dam"), 2)
    assert dam.facets == solve_case(load_case("dam"), MPI.COMM_SELF).outcome.dofs
    assert {name: part["condition"] for name, part in dam.parts.items()} == {
        "upstream": "dirichlet",
        "face": "signorini",
        "downstream": "dirichlet",
        "top": "neumann",
        "base": "neumann",
    }
    assert dam.parts["face"]["measure"] == pytest.approx(8 * 2**0.5, rel=1e-12)
    assert dam.parts["face"]["center"] == pytest.approx([18, 6])
    assert dam.regions.keys() == {"shell", "core"}
    few, many = (expected(load_case("membrane").with_values({"time.steps": steps}), 1) for steps in (1, 80))
    assert many.solver_seconds == pytest.approx(80 * few.solver_seconds)
    assert many.run_seconds > few.run_seconds
    assert 5 < expected(load_case("celia"), 1).solver_seconds < 20
    kinds = ([], ["energy"], ["mean", "integral"])
    of = [[{"name": kind, "kind": kind} for kind in each] for each in kinds]
    seconds = [expected(load_case("cube").with_values({"quantity": each}), 1).run_seconds for each in of]
    assert seconds[0] == seconds[1]
    assert seconds[2] - 3 == pytest.approx(21 * (seconds[0] - 3))


GEO = """
Point(1) = {0, 0, 0, 0.5}; Point(2) = {1, 0, 0, 0.5}; Point(3) = {1, 1, 0, 0.5}; Point(4) = {0, 1, 0, 0.5};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1}; Physical Surface("body") = {1};
Physical Curve("low") = {1}; Physical Curve("high") = {3}; Physical Curve("low again") = {1};
"""


@pytest.mark.parallel([1, 2])
def test_what_no_list_has_is_named(folder: Path):
    """Parts, and facets in no part, that become Γ_D; not a part whose facets another one gives to a list."""
    if MPI.COMM_WORLD.rank == 0:
        (folder / "square.geo").write_text(GEO)
        (folder / "own.toml").write_text(
            '[geometry]\nfile = "square.geo"\n[boundary]\nsignorini = ["low"]\n[problem]\nf = "-1"\n'
        )
    MPI.COMM_WORLD.Barrier()
    for name, left in [
        (str(folder / "own.toml"), ["high", ""]),
        ("example1", ["left", "right"]),
        ("hertz", []),
        ("fault", ["bottom", "top"]),
    ]:
        case = load_case(name)
        case = case.with_values({"solve.h": 0.5}) if name in ("example1", "hertz") else case
        found, estimate = check(case, MPI.COMM_WORLD), expected(case, 1)
        assert found.left == estimate.left == left
        for part, about in found.parts.items():
            known = estimate.parts[part]
            assert known["condition"] == about["condition"]
            assert estimate.exact is False or about["measure"] == pytest.approx(known["measure"])
    parts = expected(load_case(folder / "own.toml"), 1).parts
    conditions = {"low": "signorini", "high": "dirichlet", "low again": "none of its own"}
    assert {part: about["condition"] for part, about in parts.items()} == conditions
    for command in ("info", "check"):
        shown = signorini(folder, command, str(folder / "own.toml")).stdout
        assert "Γ_D        high, facets in no part: in no list of [boundary], so u = u_D there" in shown
    clamped = signorini(folder, "check", "hertz", "--set", 'boundary.neumann=["top"]', "--h", "0.5").stdout
    assert "Γ_D        right: in no list of [boundary], so clamped, u = u_D there" in clamped


JUMPS = "0.1 if x < 1/2 else 0"


@pytest.mark.parallel([1, 2])
def test_jumps_between_facets_are_told(folder: Path):
    """Of ψ and u_D it is told where and by how much they jump; kinks, roots and corners of the domain are no jumps."""
    square = load_case("example1").with_values({"geometry.mesh": "structured", "solve.h": 0.2})
    for values, told in (
        ({"problem.psi": JUMPS}, ["[problem] psi: jumps by 0.1 at (0.5, "]),
        ({"problem.u_D": "1 if y < 1/2 else 3*x"}, ["[problem] u_D: jumps by 2 at (1, 0.5)"]),
        ({"boundary.signorini": ["top"], "law": [{"kind": "wall", "parts": ["bottom"], "beta": JUMPS}]}, []),
        ({"problem.psi": "abs(x - 1/2) + sqrt(abs(x - 1/2)) - 1", "problem.u_D": "x + abs(y - 1/2)"}, []),
    ):
        remarks = check(square.with_values(values), MPI.COMM_WORLD).remarks
        assert len(remarks) == len(told)
        assert all(map(str.startswith, remarks, told)), remarks
    later = {"problem.psi": f"({JUMPS})*(1 if t > 1.5 else 0)", "time": {"end": 3, "steps": 3}}
    (remark,) = check(square.with_values(later), MPI.COMM_WORLD).remarks
    assert remark.startswith("step 2, t = 2: [problem] psi: jumps by 0.1 at (0.5, ")
    cube = load_case("cube").with_values({"geometry.mesh": "structured", "solve.h": 0.9})
    for psi, number in (("-1 if x < 1/2 else 0", 1), ("-abs(x - 1/2) - y", 0)):
        assert len(check(cube.with_values({"problem.psi": psi}), MPI.COMM_WORLD).remarks) == number


def test_case_files_broken_at_random(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Each is refused with one line of moderate length, or is still a case."""
    monkeypatch.chdir(tmp_path)
    rng = random.Random(7)
    said = []
    for index in range(150):
        path = write_broken_case(tmp_path, rng, index)
        try:
            load_case(path)
        except InputError as error:
            said.append(str(error))
    assert 110 < len(said) < 150
    assert not [text for text in said if "\n" in text or len(text) > 500]


def test_output_for_programs(tmp_path: Path):
    """--json prints one object, the summary; --quiet prints nothing. Errors go elsewhere, and there are no colours."""
    done = signorini(tmp_path, "solve", "example1", "--h", "1/4", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    summary = json.loads(done.stdout)
    assert summary == json.loads((tmp_path / "results" / "example1" / "summary.json").read_text())
    done = signorini(tmp_path, "solve", "example1", "--h", "1/5", "--quiet", "--output", "other")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    done = signorini(tmp_path, "compare", "results/example1", "other", "--json")
    assert 0 < json.loads(done.stdout)["jaccard"] <= 1
    done = signorini(tmp_path, "solve", "example7", "--quiet", "--json")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: unknown case")


def test_output_of_other_commands_for_programs(tmp_path: Path):
    """The objects of `export`, `convergence` and `study` are the summary, the rows with the slopes, the runs."""
    commands = {
        "export": ["r", "--output", "out"],
        "adapt": ["example1", "--h", "1/2", "--max-cells", "60", "--output", "out"],
        "convergence": ["example1", "--levels", "0:1", "--reference", "2", "--output", "out"],
    }
    assert signorini(tmp_path, "solve", "example1", "--h", "1/4", "--output", "r", "-q").stdout == ""
    for command, arguments in commands.items():
        done = signorini(tmp_path, command, *arguments, "--json")
        assert (done.returncode, done.stderr) == (0, "")
        assert json.loads(done.stdout) == json.loads((tmp_path / "out" / "summary.json").read_text()), command
    assert {"rows", "slopes"} <= json.loads((tmp_path / "out" / "summary.json").read_text()).keys()
    assert signorini(tmp_path, "export", *commands["export"], "--quiet").stdout == ""
    (tmp_path / "two.toml").write_text('case = "example1"\nvary.h = ["1/4", "1/2"]\n')
    planned = json.loads(signorini(tmp_path, "study", "two.toml", "--dry-run", "--json").stdout)
    done = json.loads(signorini(tmp_path, "study", "two.toml", "--json").stdout)
    assert [(run["status"], run["parameters"]["solve.h"]) for run in planned["runs"]] == [
        ("to do", 0.25),
        ("to do", 0.5),
    ]
    assert [run["run"] for run in done["runs"]] == [run["run"] for run in planned["runs"]]
    assert {run["status"] for run in done["runs"]} == {"done"}
    assert all(run["seconds"] > 0 and run["reason"] for run in done["runs"])
    assert signorini(tmp_path, "study", "two.toml", "--quiet").stdout == ""


def test_cases_are_listed(tmp_path: Path):
    lines = signorini(tmp_path, "cases").stdout.splitlines()
    assert [line.split()[0] for line in lines] == case_names()
    (dam,) = (line for line in lines if line.startswith("dam "))
    assert dam.split(maxsplit=2)[1:] == ["dam.msh", load_case("dam").title]


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("solve exampel1", "example1"),
        ("solve dam --algorithm primal-pdsa", "primal-pdas"),
        ("study tabels", "tables"),
        ("covergence dam", "convergence"),
    ],
)
def test_did_you_mean(tmp_path: Path, words: str, meant: str):
    done = signorini(tmp_path, *words.split())
    assert done.returncode == 2
    assert f"id you mean '{meant}'?" in done.stderr


@pytest.mark.parametrize("command", ["solve", "adapt", "export", "compare", "convergence", "study", "info", "check"])
def test_help_has_lines_of_examples(tmp_path: Path, command: str):
    lines = [line.strip() for line in signorini(tmp_path, command, "--help").stdout.splitlines()]
    (first,) = (number for number, line in enumerate(lines) if line.startswith("Example"))
    assert lines[first + 1].startswith(("signorini ", "mpirun "))
    assert not [line for line in lines if "\\b" in line]


def test_info_check_and_version(folder: Path):
    done = signorini(folder, "info", "dam")
    assert "face: signorini, 24 facets" in done.stdout
    assert "an estimate" in done.stdout
    assert json.loads(signorini(folder, "info", "lprism", "--json").stdout)["dim"] == 3
    checked = signorini(folder, "check", "dam").stdout
    assert "ready" in checked
    assert re.search(r"cells +edges from \S+ to \S+, the flattest cell 0\.\d+ times as high as long", checked)
    assert re.search(r"region +core: \d+ cells, measure \d", checked)
    assert "Γ_D" not in checked.split("ready")[1].split("\n", 1)[1]  # `dirichlet` lists its parts
    bad = signorini(folder, "check", "dam", "--set", 'boundary.signorini=["crest"]')
    assert bad.returncode == 2
    assert bad.stderr.count("unknown part 'crest'") == 1
    assert json.loads(signorini(folder, "version", "--json").stdout).keys() >= {"dolfinx", "petsc", "mpi", "python"}
    assert "\x1b" not in done.stdout + bad.stderr
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "expected"),
    [pytest.param("solve exam", "example4", marks=pytest.mark.slow), ("solve dam --algorithm al", "alg2")],
)
def test_shell_completion(words: str, expected: str):
    environment = {
        "COMP_WORDS": f"signorini {words}",
        "COMP_CWORD": str(len(words.split())),
        "_SIGNORINI_COMPLETE": "complete_bash",
    }
    done = subprocess.run(["signorini"], env=os.environ | environment, capture_output=True, text=True, check=False)
    assert expected in done.stdout.split()


def test_quiet_is_of_one_command_only(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Options of one command do not affect the next one in the same process."""
    said = []
    for words in (["check", "dam", "-q"], ["methods"], ["version", "--json"], ["methods"]):
        monkeypatch.setattr(sys, "argv", ["signorini", *words])
        with pytest.raises(SystemExit) as end:
            main()
        assert end.value.code == 0
        said.append(capsys.readouterr().out)
    quiet, methods, as_json, again = said
    assert quiet == ""
    assert methods == again
    assert methods.startswith("alg1")
    assert json.loads(as_json).keys() >= {"dolfinx"}
