"""Two bodies with points of their own, one above the other: apart, on one another, or overlapping."""

import itertools
import random
from pathlib import Path

import meshio
import numpy as np

from fuzzing.broken import OUTPUT, Broken, Valid
from signorini_fenicsx.meshes.checks import faces

LAWS = {"diffusion": "signorini", "elasticity": "contact"}


def unjoined(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A valid mesh of two bodies; whether it is refused depends on their distance and on what their faces have."""
    dim, physics = rng.choice([2, 2, 3]), rng.choice(list(LAWS))
    place, distance = rng.choice(
        [("apart", 10 ** rng.uniform(-3, 0)), ("on it", 0.0), ("in it", -(10 ** rng.uniform(-4, -1)))]
    )
    low = np.array([*(rng.choice([0.0, rng.uniform(-0.15, 0.8)]) for _ in range(dim - 1)), 1 + distance])
    high = low + [rng.choice([1.0, rng.uniform(0.2, 2)]) for _ in range(dim)]
    _write(rng, folder, [(np.zeros(dim), np.ones(dim)), (low, high)])
    laws = [face for face in ("face", "other face") if rng.random() < 0.6]
    free = [face for face in ("face", "other face", "sides") if face not in laws]
    zero = [0] * dim if physics == "elasticity" else 0
    lines = ['physics = "elasticity"'] if physics == "elasticity" else []
    lines += ["[geometry]", 'file = "bodies.msh"', "[boundary]"]
    lines += [f"{LAWS[physics]} = {laws}", f"neumann = {free}", "[problem]"]
    lines += [f"u_D = {{bottom = {zero}, top = {zero}}}"] if physics == "elasticity" else ["f = -0.1", "psi = 0"]
    lines += ["young = 1", "poisson = 0.3", f"f = {[0] * (dim - 1) + [-0.01]}"] if physics == "elasticity" else []
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    solved = place == "apart" or (place == "on it" and not laws)
    command = ["solve", "case.toml", "--output", OUTPUT] if solved or rng.random() < 0.5 else ["check", "case.toml"]
    about = f"{physics}, {dim}D, {place}: {distance:.2g}, laws on {laws}"
    return Broken(command, about, refused=not solved, solved=solved, bounded=solved)


def _write(rng: random.Random, folder: Path, boxes: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Write the mesh: turned, moved, and in any unit of length."""
    dim, points, cells, parts = len(boxes[0][0]), [], [], {}
    for names, (low, high) in zip((("bottom", "face"), ("other face", "top")), boxes, strict=True):
        x, simplices = _grid(low, high, [rng.choice([1, 2, 3]) for _ in low])
        facets, times = np.unique(faces(simplices), axis=0, return_counts=True)
        facets = facets[times == 1]
        ends = [np.isclose(x[facets][..., -1], end[-1], atol=1e-9).all(axis=1) for end in (low, high)]
        first = sum(map(len, points))
        for name, chosen in zip((*names, "sides"), (*ends, ~np.any(ends, axis=0)), strict=True):
            parts.setdefault(name, []).append(facets[chosen] + first)
        points.append(x)
        cells.append(simplices + first)
    turn, _ = np.linalg.qr([[rng.gauss(0, 1) for _ in range(dim)] for _ in range(dim)])
    moved = np.concatenate(points) @ (turn if rng.random() < 0.5 else np.eye(dim)) + rng.choice(
        [0.0, rng.uniform(-3, 3)]
    )
    moved = np.pad(moved * 10 ** rng.choice([0, 0, rng.uniform(-3, 3)]), ((0, 0), (0, 3 - dim)))
    kinds = {2: ("triangle", "line"), 3: ("tetra", "triangle")}[dim]
    blocks = [(kinds[0], np.concatenate(cells)), *((kinds[1], np.concatenate(part)) for part in parts.values())]
    tags = [np.full(len(elements), number, dtype=np.int32) for number, (_, elements) in enumerate(blocks, start=1)]
    names = {name: np.array([number, dim - 1]) for number, name in enumerate(parts, start=2)}
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    mesh = meshio.Mesh(moved, blocks, cell_data=data, field_data=names)
    meshio.write(folder / "bodies.msh", mesh, file_format="gmsh22", binary=False)


def _grid(low: np.ndarray, high: np.ndarray, counts: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """A box of so many boxes, each of simplices along its edges from its first corner to its last one."""
    ticks = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts, strict=True)]
    points = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, len(low))
    number = np.arange(len(points)).reshape([n + 1 for n in counts])
    cells = []
    for corner in itertools.product(*map(range, counts)):
        for order in itertools.permutations(range(len(low))):
            steps = np.cumsum([np.zeros(len(low), int), *(np.eye(len(low), dtype=int)[k] for k in order)], axis=0)
            cells.append([number[tuple(corner + step)] for step in steps])
    return points, np.array(cells)
