"""Names for faces of a mesh by where they are, or for several parts together, as `[geometry] faces` gives them."""

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.base.errors import InputError, telling
from signorini_fenicsx.meshes.checks import FileMesh, faces

type Rule = str | tuple[str, ...]
"""Such as "z min", "x = 0.5", or several of these and of the names of parts."""
PLACE = re.compile(r"\s*([xyz])\s*(?:(min|max)|=\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?))\s*")
ON = 1e-9
"""A vertex is on a plane up to this share of the size of the mesh."""


def check_rule(rule: object) -> Rule:
    """A rule as it was typed.

    Raises:
        ValueError: If it is none.
    """
    if isinstance(rule, str) and PLACE.fullmatch(rule):
        return rule
    if isinstance(rule, list | tuple) and rule and all(isinstance(part, str) for part in rule):
        return tuple(rule)
    raise ValueError("must be such as 'z min', 'x max' or 'y = 0.5', or a list of these and of parts")


def named(mesh: FileMesh, rules: Mapping[str, Rule], path: str) -> FileMesh:
    """The mesh of a file with a part more for each rule (rank 0).

    Raises:
        InputError: If a rule finds no facet of the boundary, or its name is that of another part.
    """
    if not rules:
        return mesh
    rows, times = np.unique(faces(mesh.cells), axis=0, return_counts=True)
    outside = rows[times == 1]
    with telling(f"mesh {path}: [geometry] faces"):
        found = {name: _found(mesh, outside, name, rule) for name, rule in rules.items()}
    return replace(mesh, parts={**mesh.parts, **found})


def _found(mesh: FileMesh, outside: Indices, name: str, rule: Rule) -> Indices:
    """The facets of a rule among those of the boundary, as ascending vertices."""
    if name in mesh.parts:
        raise InputError(f"'{name}' is a part of the file already; choose another name")
    rules = (rule,) if isinstance(rule, str) else rule
    return np.unique(np.concatenate([_of_one(mesh, outside, name, each) for each in rules]), axis=0)


def _of_one(mesh: FileMesh, outside: Indices, name: str, rule: str) -> Indices:
    """The facets of a part, or on a plane."""
    if rule in mesh.parts:
        return mesh.parts[rule]
    match = PLACE.fullmatch(rule)
    if match is None:
        raise InputError(f"{name}: unknown part '{rule}'; there are {', '.join(mesh.parts) or 'none'}")
    axis, end = "xyz".index(match[1]), match[2]
    if axis >= mesh.dim:
        raise InputError(f"a mesh in the plane has no z, which '{rule}' needs")
    along = mesh.points[:, axis]
    at = float(match[3]) if end is None else along.min() if end == "min" else along.max()
    is_on = np.abs(along - at) <= ON * np.ptp(mesh.points, axis=0).max()
    found = outside[is_on[outside].all(axis=1)]
    if len(found) == 0:
        raise InputError(f"{name}: no facet of the boundary is at {rule}")
    return found
