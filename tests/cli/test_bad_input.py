"""Bad input on the command line: one sentence, exit status 2, no file changed."""

from pathlib import Path

import pytest
from commands import launched, signorini
from mpi4py import MPI

from signorini_fenicsx.base.extras import EXTRAS

ODD = 'quantity=[{name="odd", kind="mean", weight="x - 0.5"}]'
MANY = "law=[" + 200 * '{kind="seepage", parts=["top"]}, ' + "]"
BAD_INPUT = [
    (["solve", "example7"], "unknown case 'example7'"),
    (["solve", "missing.toml"], "no such file"),
    (["solve", "example1", "--algorithm", "alg9"], "unknown algorithm 'alg9'"),
    (["solve", "example1", "--backend", "magic"], "backend"),
    (["solve", "example1", "--h", "0"], "greater than 0"),
    (["solve", "example1", "--h=-1"], "greater than 0"),
    (["solve", "example1", "--h", "nan"], "not a number"),
    (["solve", "example1", "--h", "5"], "larger than the domain"),
    (["solve", "example1", "--h", "1e-6"], "asks for about"),
    (["solve", "example1", "--h", "1e-5"], "case example1: [solve] h = 1e-05 asks for"),
    (["solve", "example1", "--set", "problem.kappa=-1"], "case example1: [problem] kappa: must be positive"),
    (["check", "example1", "--set", "problem.kappa=-1"], "case example1: [problem] kappa: must be positive"),
    (["solve", "example1", "--set", "max_iterations=3"], "'max_iterations' is a key of [solve]"),
    (["solve", "example1", "--output", "\udcff"], "'\\udcff': is not in UTF-8"),
    (["solve", "example1", "--set", 'boundary.signorini=["\\u001b"]'], "unknown part '\\x1b'"),
    (["check", "example1", "--set", "boundary.signorini=[]", "--set", MANY], "law.0.parts and in law.1.parts"),
    (["solve", "example1", "--set", ODD], "[[quantity]] odd: weight: its integral is 0, so there is no mean with it"),
    (["solve", "example1", "--rho", "0"], "greater than 0"),
    (["solve", "example1", "--algorithm", "vi", "--rho", "2"], "--rho: vi has no such option; alg1"),
    (["solve", "example1", "--eps", "1e-3"], "--eps: alg1 has no such option; alg3"),
    (["adapt", "example1", "--max-cells", "99", "--eps", "1e-3"], "--eps: alg1 has no such option; alg3"),
    (["check", "example1", "--algorithm", "qp", "--backend", "mixed"], "--backend: qp has no such option; alg1"),
    (["solve", "example1", "--for-signorini"], "--for-signorini: there is no such option for Algorithm 1"),
    (["solve", "hertz", "--for-signorini"], "--for-signorini: there is no such option for elastic contact"),
    (["solve", "example1", "--set", "problem.f=__import__('os')"], "__import__"),
    (["solve", "example1", "--set", "problem.g=1"], "unknown key 'g'"),
    (["solve", "example1", "--set", "nonsense"], "KEY=VALUE"),
    (["solve", "example1", "--h", "1/4", "--set", "solve.h=1"], "solve.h has the value '1/4' already"),
    (["solve", "example1", "--output", "file"], "is a file"),
    (["solve", "example1", "--output", "file/below"], "cannot be written"),
    (["solve", "example1", "--output", "full"], "is not empty"),
    (["solve", "example1", "--output", "/proc/signorini"], "cannot be written"),
    (["solve", "example1", "--output", "/"], "mount point"),
    (["solve", "example1", "--output", "."], "is not empty"),
    (["solve", "example1", "--output", "loop"], "loop"),
    (["solve", "full.toml"], "is a folder"),
    (["solve", "example1", "--set", "solve=1"], "must be a section"),
    (["solve", "example1", "--set", "solve.h.x=1"], "no such key"),
    (["solve", "example1", "--set", "solve.h=true"], "must be a number"),
    (["solve", "example1", "--set", "name=x"], "unknown key 'name'"),
    (["solve", "example1", "--set", r"a\[/b]=1"], "unknown key"),
    (["solve", "example1", "--set", "solve.max_iterations=99999999999"], "between 1 and"),
    (["solve", "example1", "--set", "problem.f=min(x, 1e999)"], "not finite"),
    (["solve", "example1", "--set", "problem.f=" + "+".join(["x*y"] * 400)], "nested too deeply"),
    (["solve", "example1", "--set", "problem.f=1e200*x"], "outside 1e-100"),
    (["solve", "example1", "--set", "problem.f=1e-200*x"], "outside 1e-100"),
    (["solve", "example1", "--set", "problem.f=sqrt(x - 0.5)"], "not finite"),
    (["solve", "example1", "--h", "1/4", "--", "-mat_type", "nonsense"], "PETSc options: Unknown type"),
    (["solve", "example1", "--h", "1/4", "--", "-pc_factor_mat_solver_type", "nonsense"], "PETSc options: Could not"),
    (["solve", "example1", "--", "-options_file", "nowhere"], "PETSc cannot start with its options: Unable to open"),
    (["solve", "example1", "--h", "2^-1000"], "must be between 1e-90 and 1e+90"),
    (["info", "example1", "--h", "1e-300"], "must be between 1e-90 and 1e+90"),
    (["info", "cube", "--set", "solve.h=1e-90"], "asks for about"),
    (["check", "example1", "--set", "solve.max_iterations=" + "9" * 5000], "is not a number"),
    (["check", "example1", "--set", "solve.max_iterations=0x" + "f" * 400], "at most 1000 bits"),
    (["check", "example1", "--set", "problem.f=0x" + "f" * 5000], "at most 1000 bits"),
    (["check", "example1", "--set", "boundary.signorini=[0x" + "f" * 5000 + "]"], "not this int"),
    (["adapt", "example1", "--max-cells", "99", "--theta", "0x" + "f" * 400], "--theta: '0xfff"),
    (["study", "a\0.toml"], "no such file"),
    (["study", "/dev/zero"], "no such file"),
    (["check", "x" * 5000 + ".toml"], "File name too long"),
    (["export", "x" * 300], "File name too long"),
    (["solve", "example1", "--output", "x" * 300], "File name too long"),
    (["check", "x" * 5000], "x … "),
    (["solve", "example1", "--colour"], "No such option"),
    (["export", "/"], "holds no checkpoint"),
    (["compare", "full", "file", "--output", "full/../file"], "is one of the runs"),
    (["adapt", "example2"], "give --target"),
    (["adapt", "example2", "--target", "0"], "must be greater than 0"),
    (["adapt", "example2", "--target", "small"], "is not a number"),
    (["adapt", "example2", "--max-cells", "0"], "at least 1"),
    (["adapt", "example2", "--max-cells", "1000", "--theta", "1.5"], "between 0.001"),
    (["adapt", "example2", "--max-cells", "1000", "--theta", "1e-300"], "between 0.001"),
    (["adapt", "example2", "--max-cells", "10"], "more than the 10 allowed"),
    (["convergence", "example1", "--levels", "5:2"], "FIRST:LAST"),
    (["convergence", "example1", "--levels", "a:b"], "--levels a:b: must be"),
    (["convergence", "example1", "--levels", "2:4", "--reference", "4"], "finer"),
    (["convergence", "example1", "--vary", "rho"], "must be one of"),
    (["convergence", "example1", "--levels", "2:" + "9" * 5000], "FIRST:LAST"),
    (["convergence", "example1", "--reference", "9" * 400], "finer"),
    (["convergence", "example1", "--vary", "eps"], "alg1 has no ε; alg3"),
    (["solve", "example4", "--eps", "0"], "greater than"),
    (["solve", "example4", "--eps", "nan"], "not a number"),
    (["solve", "example4", "--eps", "1e-15"], "must be between 1e-14 and 1e+06"),
    (["solve", "example4", "--eps", "1e7"], "must be between 1e-14 and 1e+06"),
]


def untouchable(folder: Path) -> list[Path]:
    """Files and folders that are in the way of a command, which must not change them."""
    (folder / "file").write_text("mine")
    (folder / "full").mkdir()
    (folder / "full" / "mine").write_text("mine")
    (folder / "full.toml").mkdir()
    (folder / "loop").symlink_to("loop")
    return sorted(folder.rglob("*"))


AS_TYPED = ("PETSc options: Could not", "PETSc cannot start with its options: Unable to open")
ON_RANKS = ("PETSc options: Unknown type",)
IN_PARALLEL = ("unknown case 'example7'", "asks for about", "is a file", "mount point", "outside 1e-100", "--target")


@pytest.mark.parametrize(("arguments", "message"), [row for row in BAD_INPUT if row[1] in AS_TYPED])
def test_bad_input_as_typed(tmp_path: Path, arguments: list[str], message: str):
    """One sentence, exit status 2, no traceback, nothing written."""
    before = untouchable(tmp_path)
    done = launched(tmp_path, *arguments)
    assert done.returncode == 2, done.stderr
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(("arguments", "message"), [row for row in BAD_INPUT if row[1] not in AS_TYPED + ON_RANKS])
def test_bad_input(tmp_path: Path, arguments: list[str], message: str):
    """The same in this process."""
    before = untouchable(tmp_path)
    done = signorini(tmp_path, *arguments)
    assert done.returncode == 2
    words = " ".join(done.stderr.split())
    assert message in words
    assert len(words) < 1200
    assert sorted(tmp_path.rglob("*")) == before


def test_files_with_a_byte_order_mark_and_control_characters(tmp_path: Path):
    """Some editors begin a file with a mark; what a title does to a terminal is shown, not done."""
    text = 'title = "a\\u001b[31mb\\u0007"\n[geometry]\nshape = "square"\n[problem]\nf = 1\n'
    text += '[boundary]\nsignorini = ["top"]\n'
    (tmp_path / "a.toml").write_text(text, encoding="utf-8-sig")
    done = signorini(tmp_path, "check", "a.toml", "--h", "1/2")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(r"a\x1b[31mb\x07")
    (tmp_path / "s.toml").write_text('case = "a.toml"\ntitle = "\\u001b"\n[vary]\nh = ["1/2"]', encoding="utf-8-sig")
    done = signorini(tmp_path, "study", "s.toml", "--dry-run")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(r"\x1b")
    assert "\x1b" not in done.stdout


@pytest.mark.parametrize("option", list(EXTRAS))
def test_options_whose_package_is_missing(tmp_path: Path, monkeypatch, option: str):
    """A small installation says what to install, before anything is solved."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    done = signorini(tmp_path, "solve", "example1", option)
    assert done.returncode == 2
    assert f"{option}: needs a package that is not installed; `pip install 'signorini_fenicsx[" in done.stderr
    assert list(tmp_path.rglob("*")) == []


@pytest.mark.parallel(2)
@pytest.mark.parametrize(("arguments", "message"), [row for row in BAD_INPUT if row[1] in IN_PARALLEL])
def test_bad_input_in_parallel(folder: Path, arguments: list[str], message: str):
    """All ranks end with the status, whichever rank finds the error."""
    if MPI.COMM_WORLD.rank == 0:
        untouchable(folder)
    done = signorini(folder, *arguments)
    assert done.returncode == 2
    assert message in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "message"), [row for row in BAD_INPUT if row[1] in ON_RANKS])
def test_bad_input_in_parallel_is_said_once(tmp_path: Path, arguments: list[str], message: str):
    before = untouchable(tmp_path)
    done = launched(tmp_path, *arguments, ranks=2)
    assert done.returncode == 2
    assert done.stderr.count(message) == 1
    assert "Traceback" not in done.stderr
    assert sorted(tmp_path.rglob("*")) == before
