"""Cases for tests: small ones of their own, and shipped ones with other values; a law, and options of PETSc."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from capabilities import CASES
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.owned import number_of_cells
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.contact.law import Graph, Law, Values
from signorini_fenicsx.expressions.given import Given
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.refinement import refine
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.solution import Solution

COMM = MPI.COMM_WORLD

SQUARE_BODY = """
physics = "elasticity"

[geometry]
shape = "square"
mesh = "structured"

[boundary]
neumann = ["left", "right"]
"""
"""The beginning of a case of elastic contact."""
EXACT = ("friction", "two_sided", "wall", "regulator", "staircase")
CASE = """
title = "A test case"

[geometry]
shape = "{shape}"
mesh = "{mesh}"

[boundary]
signorini = {parts}

[problem]
f = "{f}"

[solve]
h = {h}
"""


@dataclass(frozen=True)
class Spring(Law):
    """A law of one's own: κ∇u·n = −stiffness u."""

    stiffness: Given = 1.0
    segments = ("spring",)

    def graph(self, values: Values) -> Graph:
        """A line has a corner too, without a bend."""
        return Graph((0.0, 0.0), [(0.0, 0.0)], values["stiffness"], values["stiffness"])


def make_case(
    folder: Path, *, shape: str = "square", mesh: str = "unstructured", parts: list[str], f: str, h: float
) -> Case:
    """Write a case file and load it (collective)."""
    path = folder / "case.toml"
    if COMM.rank == 0:
        path.write_text(CASE.format(shape=shape, mesh=mesh, parts=parts, f=f, h=h), encoding="utf-8")
    COMM.Barrier()
    return load_case(path)


@contextmanager
def petsc_options(**given: object) -> Iterator[PETSc.Options]:
    """Options of PETSc, for a while."""
    options = PETSc.Options()
    for name, value in given.items():
        options[name] = value
    try:
        yield options
    finally:
        for name in given:
            options.delValue(name)


def case_of(solution: Solution) -> Case:
    """The case of a solution."""
    assert isinstance(solution.source, Case)
    return solution.source


def many(**values: object) -> Case:
    """A case with six laws and no Γ_D."""
    return load_case(CASES / "many.toml").with_values(values)


def on_grid(name: str, n: int, **values: object) -> Solution:
    """An exact case on a structured mesh of n × n squares."""
    given = {"geometry.mesh": "structured", "solve.h": 1.0001 * math.sqrt(2) / n}
    return solve_case(load_case(name).with_values(given | {key.replace("__", "."): to for key, to in values.items()}))


def blocks(folder: Path, *changes: tuple[str, str], law: str = 'kind = "contact"', load: float = -0.1) -> Path:
    """A case file of two elastic blocks with a law between them, with texts replaced (collective)."""
    mesh = str(Path(__file__).parents[1] / "data" / "meshes" / "fault.msh")
    text = (
        (CASES / "blocks.toml")
        .read_text(encoding="utf-8")
        .replace("FAULT", mesh)
        .replace("LAW", law)
        .replace("LOAD", str(load))
    )
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "blocks.toml"
    if COMM.rank == 0:
        path.write_text(text, encoding="utf-8")
    COMM.Barrier()
    return path


def on_square(n: int, signorini: list[str], **values: object) -> Case:
    """A case on a structured mesh of the square."""
    given = {"problem.f": "40*(x - 0.6)", "boundary.signorini": signorini, "solve.algorithm": "alg1"}
    given |= {"geometry.mesh": "structured", "solve.h": 1.001 * math.sqrt(2) / n}
    return load_case("example1").with_values(given | {key.replace("__", "."): value for key, value in values.items()})


def rotated(ratio: float, degrees: float) -> list[list[str]]:
    """κ with the eigenvalues 1 and 1/ratio."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    matrix = np.outer([c, s], [c, s]) + np.outer([-s, c], [-s, c]) / ratio
    return [[repr(float(entry)) for entry in row] for row in matrix]


def refined(domain: Domain, times: int) -> Domain:
    """The domain with all cells refined so often (collective)."""
    for _ in range(times):
        domain = refine(domain, np.arange(number_of_cells(domain.mesh), dtype=np.int32))
    return domain
