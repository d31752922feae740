"""The kinds of inputs by name, and valid results from which some of them are made."""

from pathlib import Path

from broken_input import msh_text, square_msh

from fuzzing.broken import Generator, Valid
from fuzzing.cases import case_file
from fuzzing.checkpoints import checkpoint
from fuzzing.drawn import drawn
from fuzzing.elastic import few_facets
from fuzzing.expressions import expression
from fuzzing.geometries import geometry
from fuzzing.judge import Ending
from fuzzing.laws import law_file
from fuzzing.meshes import CASE, mesh_file
from fuzzing.opened import LIFTED, opened
from fuzzing.options import ends_early, option
from fuzzing.others import configuration, forged
from fuzzing.places import far_place
from fuzzing.pulses import pulses
from fuzzing.quantities import quantities
from fuzzing.runner import Runner
from fuzzing.studies import study
from fuzzing.unjoined import unjoined

GENERATORS: dict[str, Generator] = {
    "case": case_file,
    "law": law_file,
    "elastic": few_facets,
    "option": option,
    "expression": expression,
    "mesh": mesh_file,
    "geo": geometry,
    "checkpoint": checkpoint,
    "study": study,
    "forged": forged,
    "config": configuration,
    "far": far_place,
    "pulse": pulses,
    "early": ends_early,
    "unjoined": unjoined,
    "drawn": drawn,
    "opened": opened,
    "quantity": quantities,
}


def make_valid(pencil: Path, runner: Runner) -> Valid:
    """Make some results with the program itself.

    Raises:
        RuntimeError: If it fails.
    """
    root = pencil / "valid"
    for folder in ("work", "home", "tmp", "said"):
        (root / folder).mkdir(parents=True)
    work = root / "work"
    (work / "square.msh").write_text(msh_text(*square_msh(3)), encoding="utf-8")
    text = CASE.format(file="square.msh").replace('["1"]', '["bottom"]')
    (work / "mesh.toml").write_text(text, encoding="utf-8")
    (work / "lifted.toml").write_text(LIFTED, encoding="utf-8")

    def check(ending: Ending) -> None:
        if ending.status != 0:
            raise RuntimeError(f"a valid case is not solved: {ending.said}")

    cases = {"shape": ["example1", "--h", "1/4"], "file": ["mesh.toml"], "opened": ["lifted.toml"]}
    for output, words in cases.items():
        runner.start(["solve", *words, "--output", output], root, check)
    runner.finish()
    return Valid(*(work / output for output in cases), pencil)
