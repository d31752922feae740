"""Bodies with meshes of their own, from files, shapes and domains: names, places, sizes, ranks, wrong case files."""

import json
from pathlib import Path

import numpy as np
import pytest
from commands import signorini
from mpi4py import MPI

from signorini_fenicsx import InputError, domain_of_bodies
from signorini_fenicsx.base.shipped import data_folder
from signorini_fenicsx.meshes.bodies import Bodies, Body
from signorini_fenicsx.meshes.meshing import build_domain, own_domain

COMM = MPI.COMM_WORLD
DAM = str(data_folder("meshes") / "dam.msh")
CASE = """
physics = "elasticity"
[geometry]
bodies = {{{bodies}}}
[boundary]
neumann = ["up.left", "up.right", "low.top"]
[problem]
young = {{up = 1, low = 2}}
poisson = 0
u_D = {{"up.top" = [0, -0.1]}}
g_N = {{"low.top" = [0, "-1"]}}
"""
UP = 'up = {shape = "square", offset = [0, 1.5], h = 0.4}, '
LOW = 'low = {shape = "[0, 1] x [0, 1]", h = 0.8, mesh = "structured"}'


@pytest.mark.parallel([1, 3])
def test_shapes_and_files_become_one_domain() -> None:
    """Parts and regions have the names of bodies, places are moved, and the coarsest body gets h."""
    bodies = {"dam": Body(file=DAM, offset=(0.0, -100.0)), "up": Body("square", offset=(3.0, 2.0), h=0.25)}
    source = Bodies(bodies)
    domain = own_domain(COMM, source, None, {})
    assert {"dam.upstream", "up.top"} <= {*domain.parts}
    assert [*domain.regions][-1] == "up"
    assert np.allclose(domain.box()[1, :2], [max(4, domain.box()[1, 0]), 3])
    finer = own_domain(COMM, source, domain.h / 2, {})
    assert finer.h <= domain.h / 2 * (1 + 1e-9)
    cells = [COMM.allreduce(len(each.regions["up"])) for each in (domain, finer)]
    assert 2.5 * cells[0] < cells[1] < 6 * cells[0]
    assert finer.cells - cells[1] == 4 * (domain.cells - cells[0])


@pytest.mark.parallel([1, 3])
def test_domains_are_joined_in_python() -> None:
    """`domain_of_bodies` names parts and regions as a case file does."""
    square = build_domain(COMM, "square", 0.5, mesh="structured")
    domain = domain_of_bodies({"a": square, "b": build_domain(COMM, "[1, 2] x [2, 3]", 0.8, mesh="structured")})
    assert [*domain.regions] == ["a", "b"]
    assert len(domain.parts) == 8
    assert COMM.allreduce(len(domain.regions["a"])) == square.cells
    for bodies, words in (({"a.b": square}, "no name of a body"), ({}, "empty"), ({"a": 1}, "must be a Domain")):
        with pytest.raises(InputError, match=words):
            domain_of_bodies(bodies)


WRONG = [
    ("up = 3", "must be a section"),
    ('up = {shape = "square", file = "a.msh"}', "either a shape or a file"),
    ('"u.p" = "a.msh"', "no name of a body"),
    (UP + 'low = {shape = "cube", h = 1}', "'up' has 2 dimensions, and 'low' has 3"),
    (UP + 'low = {shape = "square", offset = [1], h = 1}', "offset must have 2 numbers"),
    (UP + 'low = {shape = "slit", h = 1}', "has a part inside"),
    (UP + 'low = {shape = "square"}', "bodies.low: needs h"),
    (UP + 'low = "nothing.msh"', "no such file"),
    (UP + f'low = {{file = "{DAM}", h = 99}}', "can be refined only"),
]


@pytest.mark.parametrize(("bodies", "words"), WRONG)
def test_wrong_bodies_are_refused(tmp_path: Path, bodies: str, words: str) -> None:
    """One sentence, exit status 2."""
    (tmp_path / "case.toml").write_text(CASE.format(bodies=bodies))
    done = signorini(tmp_path, "solve", "case.toml")
    assert done.returncode == 2
    assert words in " ".join(done.stderr.split())


def test_on_the_command_line(tmp_path: Path) -> None:
    """Bodies apart are solved one by one; `--h` refines both."""
    (tmp_path / "case.toml").write_text(CASE.format(bodies=UP + LOW))
    for h, folder in (("0.8", "a"), ("0.4", "b")):
        done = signorini(tmp_path, "solve", "case.toml", "--h", h, "--output", folder)
        assert done.returncode == 0, done.stderr
    summaries = [json.loads((tmp_path / folder / "summary.json").read_text()) for folder in "ab"]
    assert summaries[0]["cells"] * 2.5 < summaries[1]["cells"]
