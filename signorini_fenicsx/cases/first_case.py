"""The text of a first case: a shape or a mesh, a physics, and a word for what holds on each part of the boundary."""

import inspect
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from signorini_fenicsx.base.arrays import rows_of
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.reading import text_of
from signorini_fenicsx.base.shipped import file_of
from signorini_fenicsx.base.text import did_you_mean
from signorini_fenicsx.cases.first_pairs import Facing, facing
from signorini_fenicsx.cases.toml_files import read_toml
from signorini_fenicsx.contact.law import LawWithMemory, names_of_data
from signorini_fenicsx.contact.laws import LAWS
from signorini_fenicsx.meshes.bodies import Bodies, Body
from signorini_fenicsx.meshes.checks import faces
from signorini_fenicsx.meshes.files import read_mesh_file
from signorini_fenicsx.meshes.shapes import full_name, shape_of
from signorini_fenicsx.solving.physics import DIFFUSION, PHYSICS

VALUES: Mapping[str, Any] = {
    **{"g": 1, "psi_upper": 1, "beta": 1, "k": 1, "g_low": -1, "g_high": 1, "r": 1, "bed": -1},
    "corners": [[-1, 1], [1, -1]],
}
"""Data of laws; for others their defaults are written, or 0."""
HELD, GIVEN, SYMMETRIC = "dirichlet", "neumann", "symmetry"


@dataclass(frozen=True)
class Place:
    """The domain of a problem: its shape or its mesh.

    Attributes:
        geometry: The lines of `[geometry]`.
        parts: The parts of the boundary, and those inside.
        inside: Those that are inside.
        dim: The dimension.
        pairs: Parts of bodies that share no nodes and are near one another.
    """

    geometry: str
    parts: Sequence[str]
    inside: Sequence[str]
    dim: int
    pairs: Sequence[Facing] = ()

    @classmethod
    def of(cls, name: str, folder: Path) -> "Place":
        """A shape by its name, or a mesh by the path of its file, for a case in this folder (rank 0).

        Raises:
            InputError: If there is no such shape, or the mesh cannot be used.
        """
        if not Path(name).suffix or name.startswith("["):
            shape = shape_of(full_name(name))
            return cls(f"shape = {json.dumps(full_name(name))}", shape.names, shape.inside, shape.dim)
        mesh = read_mesh_file(name)
        rows, times = np.unique(faces(mesh.cells), axis=0, return_counts=True)
        rows_of_parts = {part: rows_of(facets, rows) for part, facets in mesh.parts.items()}
        inside = [part for part, own in rows_of_parts.items() if np.any(times[own[own >= 0]] > 1)]
        return cls(f"file = {_path(name, folder)}", list(rows_of_parts), inside, mesh.dim, facing(mesh))

    @classmethod
    def of_bodies(cls, files: Mapping[str, str], folder: Path) -> "Place":
        """Bodies by the paths of their meshes, for a case in this folder (rank 0).

        Raises:
            InputError: If a mesh cannot be used.
        """
        mesh, _ = Bodies({name: Body(file=file) for name, file in files.items()}).read(None)
        entries = ", ".join(f"{name} = {_path(file, folder)}" for name, file in files.items())
        return cls(f"bodies = {{{entries}}}", list(mesh.parts), [], mesh.dim, facing(mesh))

    def of_pairs(self, conditions: Mapping[str, str], usual: str) -> dict[Facing, str]:
        """The pairs whose parts have no condition of their own, with their kinds: the usual one, if no other is given.

        Args:
            conditions: Words for parts; that of a pair is given for one of its sides.
            usual: The usual kind.
        """
        given = {pair: {conditions.get(pair.slave), conditions.get(pair.master)} - {None} for pair in self.pairs}
        kinds = {pair: words.pop() if words else usual for pair, words in given.items() if len(words) < 2}
        return {pair: str(kind) for pair, kind in kinds.items() if kind not in (HELD, GIVEN, SYMMETRIC)}


def _path(name: str, folder: Path) -> str:
    """A path as seen from a folder, quoted."""
    return json.dumps(Path(os.path.relpath(name, folder)).as_posix())


def words(physics: str) -> tuple[str, ...]:
    """What may hold on a part, in a word."""
    return HELD, GIVEN, *PHYSICS[physics].case.first_words


def first_law(physics: str) -> str:
    """The plainest law of a physics, which one part has if no other law was chosen."""
    return next(word for word in words(physics) if word not in (HELD, GIVEN, SYMMETRIC))


def check_word(word: str, physics: str) -> str:
    """The word, if there is such a condition.

    Raises:
        InputError: If not.
    """
    if word not in (known := words(physics)):
        raise InputError(f"unknown condition '{word}'; use one of {', '.join(known)}{did_you_mean(word, known)}")
    return word


def case_text(title: str, place: Place, physics: str, conditions: Mapping[str, str]) -> str:
    """A case file; where no condition is given, u is.

    Args:
        title: Its title.
        place: Where it is posed.
        physics: One of `PHYSICS`.
        conditions: Words for parts.

    Raises:
        InputError: If there is no such part, physics or condition.
    """
    if physics not in PHYSICS:
        raise InputError(
            f"unknown physics '{physics}'; use one of {', '.join(PHYSICS)}{did_you_mean(physics, PHYSICS)}"
        )
    kinds = PHYSICS[physics].case.first_pairs
    pairs = place.of_pairs(conditions, kinds[0]) if kinds else {}
    paired = {part: kind for pair, kind in pairs.items() for part in (pair.slave, pair.master)}
    for part, word in conditions.items():
        if part not in place.parts:
            raise InputError(f"unknown part '{part}'; the parts are {', '.join(place.parts)}")
        if part not in paired or word not in kinds:
            check_word(word, physics)
    outer = {part: conditions.get(part, HELD) for part in place.parts if part not in [*place.inside, *paired]}
    inner = {part: word for part, word in conditions.items() if part in place.inside}
    for part, word in inner.items():
        if word in (HELD, GIVEN, SYMMETRIC):
            raise InputError(f"part '{part}' is inside the domain, where '{word}' cannot hold; give it a law")
    head = [f"title = {json.dumps(title, ensure_ascii=False)}"]
    if physics != DIFFUSION:
        head.append(f'physics = "{physics}"')
    sections = [
        "\n".join(head),
        f"[geometry]\n{place.geometry}",
        *_sections(PHYSICS[physics].case, outer, inner, place),
    ]
    sections[-1:-1] = [_pair_section(pair, kind, PHYSICS[physics].case.first_laws) for pair, kind in pairs.items()]
    if place.geometry.startswith("shape") and place.dim == 3:
        sections.append('[solve]\nh = "1/8"')
    return "\n\n".join(sections) + "\n"


def _sections(case: Any, outer: Mapping[str, str], inner: Mapping[str, str], place: Place) -> list[str]:
    """The sections of a case file, with words for the parts of the boundary and for those inside."""
    plain = case.first_words[0]
    lists = {plain: parts_with(outer, *(case.first_listed or [plain])), GIVEN: parts_with(outer, GIVEN)}
    keys = case.model_fields["boundary"].annotation.model_fields
    lines = [f"{key} = {_json(parts)}" for key, parts in lists.items() if key in keys and (parts or not place.pairs)]
    lines += [f"inner = {_json(list(inner))}"] if inner else []
    lines.append(f"# u is given on the rest: {', '.join(parts_with(outer, HELD)) or 'nothing'}")
    if fixed := parts_with(outer, SYMMETRIC):
        axes = ", ".join(f'{_json(part)} = "n"' for part in fixed)
        lines.append(f"fixed = {{{axes}}}  # u·n is given there; also letters of xyz")
    laws = {part: word for part, word in outer.items() if word not in (HELD, GIVEN, SYMMETRIC, plain)} | {**inner}
    numbers = {"down": [0] * (place.dim - 1) + [-0.01], "zero": [0] * place.dim}
    in_time = ["[time]\nend = 1\nsteps = 10"] if any(_has_memory(word) for word in laws.values()) else []
    needed = [(line, about) for line, about, word in case.first_data if not word or parts_with(outer, *word.split())]
    data = [(line.format(**numbers), about.format()) for line, about in needed]
    width = max(len(line) for line, _ in data)
    problem = [f"{line:<{width}}  # {about}" if about else line for line, about in data]
    return [
        "\n".join(["[boundary]", *lines]),
        *law_sections(laws, case.first_laws),
        "\n".join(["[problem]", *problem]),
        *in_time,
    ]


def _has_memory(word: str) -> bool:
    """Whether a law changes from step to step, so that it needs [time]."""
    return word in LAWS and issubclass(LAWS[word], LawWithMemory)


def _pair_section(pair: Facing, kind: str, special: Mapping[str, tuple[str, list[str]]]) -> str:
    """A [[pair]], with how its parts are opposite to each other."""
    _, data = special.get(kind, ("", [])) if kind in special or kind not in LAWS else _about(kind)
    about = (
        f"# {100 * pair.share:.3g} % of the slave is opposite to the master, at {pair.least:.3g} to {pair.most:.3g}."
    )
    lines = [about, "[[pair]]", f"slave = {_json(pair.slave)}", f"master = {_json(pair.master)}", f'kind = "{kind}"']
    return "\n".join([*lines, *data])


def _json(names: object) -> str:
    """Names as TOML has them."""
    return json.dumps(names, ensure_ascii=False)


def parts_with(conditions: Mapping[str, str], *names: str) -> list[str]:
    """The parts that have one of these words."""
    return [part for part, word in conditions.items() if word in names]


def law_sections(
    given: Mapping[str, str], special: Mapping[str, tuple[str, list[str]]] = MappingProxyType({})
) -> list[str]:
    """A [[law]] for each kind, with what it says and all its data."""
    texts = []
    for kind in dict.fromkeys(given.values()):
        parts = _json(parts_with(given, kind))
        about, data = special[kind] if kind in special else _about(kind)
        about = f"{about} Here u is the opening, κ∇u·n the pressure." if special and kind not in special else about
        texts.append("\n".join([f"# {about}", "[[law]]", f"parts = {parts}", f'kind = "{kind}"', *data]))
    return texts


def _about(kind: str) -> tuple[str, list[str]]:
    """The graph of a law in words, and its data with values."""
    law = LAWS[kind]
    values = {datum.name: datum.default for datum in fields(law)}
    sentence = (inspect.getdoc(law) or "").split("\n\n")[0].replace("\n", " ")
    return sentence, [f"{name} = {_written(VALUES.get(name, values[name]))}" for name in names_of_data(law)]


def _written(value: object) -> str:
    """A number or a list; 0 for what has no default."""
    return json.dumps(value) if isinstance(value, list) else f"{value if isinstance(value, int | float) else 0:g}"


def shipped_text(name: str) -> str:
    """The file of a shipped case, which can be solved wherever it is saved: the path of its mesh is absolute.

    Raises:
        InputError: If there is no such case.
    """
    path = file_of("case", name)
    text, geometry = text_of(path), read_toml(path).get("geometry", {})
    bodies = [body if isinstance(body, str) else body.get("file") for body in geometry.get("bodies", {}).values()]
    for file in filter(None, [geometry.get("file"), *bodies]):
        text = text.replace(json.dumps(file), json.dumps(os.path.normpath(path.parent / file)))
    return text
