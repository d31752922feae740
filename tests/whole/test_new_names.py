"""What the changelog writes in the place of the Python names of 0.4 works, and what docstrings of conditions write."""

import builtins
import re
from pathlib import Path
from typing import Any

import dolfinx.mesh
import numpy as np
import pytest
from dolfinx.mesh import create_unit_square
from mpi4py import MPI

import signorini_fenicsx
from signorini_fenicsx import api, extend
from signorini_fenicsx.contact.law import OnParts
from signorini_fenicsx.physics.elasticity.conditions import JointSprings

SIDES = {"bottom": (1, 0.0), "right": (0, 1.0), "top": (1, 1.0), "left": (0, 0.0)}


def translations() -> list[tuple[str, str]]:
    """The rows of the changelog's table: how something was written in 0.4, and how in 0.5."""
    text = Path(__file__).parents[2].joinpath("CHANGELOG.md").read_text(encoding="utf-8")
    lines = text.split("## 0.4.0")[0].splitlines()
    rows = [line.strip().strip("|").split(" | ") for line in lines if line.strip().startswith("| `")]
    return [(old.strip(" `"), new.strip(" `")) for old, new in rows]


class Names(dict[str, Any]):
    """The names of a program that uses `signorini_fenicsx`."""

    def __missing__(self, name: str) -> Any:
        """What the package has of this name."""
        if hasattr(builtins, name):
            raise KeyError(name)
        return getattr(signorini_fenicsx, name)


@pytest.fixture(scope="module")
def names() -> Names:
    """Names with the unit square, a scalar and an elastic solution on it."""
    mesh = create_unit_square(MPI.COMM_WORLD, 6, 6)
    found = Names(extend=extend)
    found["domain"] = signorini_fenicsx.domain_of(
        mesh,
        {
            side: dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x, i=i, at=at: np.isclose(x[i], at))
            for side, (i, at) in SIDES.items()
        },
    )
    found["solution"], found["body"] = (value(new, found) for _, new in (translations()[0], translations()[5]))
    return found


def value(text: str, names: Names) -> Any:
    """The value of an expression of the table, of our own file."""
    return eval(text.replace("`", ""), names)


@pytest.mark.parametrize("new", [new for _, new in translations()])
def test_the_table_of_new_names(new: str, names: Names, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if "results" in new:
        names["body"].write("results/body")
    assert value(new, names) is not None


@pytest.mark.parametrize("name", ["Problem", "solve_elastic", "SetRule"])
def test_names_of_before(name: str) -> None:
    with pytest.raises(AttributeError, match=f"no attribute '{name}'; CHANGELOG.md translates"):
        getattr(signorini_fenicsx, name)


def test_the_top_level() -> None:
    """It has the names that programs need, at most 52."""
    assert len(signorini_fenicsx.__all__) <= 52


def test_problems_know_their_solutions(names: Names) -> None:
    """By the class that a problem names editors know what `solve` gives."""
    for kind, solution in (("Diffusion", "solution"), ("Elasticity", "body")):
        problem = value(f"{kind}(1.0, 0.3)", names)
        assert type(names[solution]) is problem.solution_type


def test_conditions_say_how_they_are_used():
    """The docstring of each condition has what makes one."""
    given = [getattr(api, name) for name in api.__all__]
    conditions = {each for each in given if isinstance(each, type) and issubclass(each, OnParts)}
    for kind in [*conditions, JointSprings, api.Pair, api.Tresca, api.Coulomb]:
        usage = re.findall(r"`(\w+\(.*?\))`", kind.__doc__ or "")
        made = [eval(line, {**vars(api), "JointSprings": JointSprings}) for line in usage]
        assert kind in {type(each) for one in made for each in (one, getattr(one, "friction", None))}, kind
