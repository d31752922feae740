"""Texts for people in every picture, on meshes with parts or without, where HOME may not be set: nothing may fail."""

import json
import random
from pathlib import Path

from fuzzing.broken import OUTPUT, Broken, Valid

TEXTS = (
    *(
        r"$\bm{\sigma}$",
        "in_$flow_$",
        "$$",
        "$",
        r"\$",
        "$x^2$",
        "5$, $b",
        "a % $ \\",
        "接触 🦆",
        "{_^}",
        "$\\frac{1$",
        "#x",
    ),
    *("$" + 400 * "{" + "$", 300 * "x", 90 * "long, "),
)
CONTROLS = ("\x1b[31m", "a\nb$\nc$", "\t", "\x00", "\u202eabc")
"""These are no names of parts in a file of Gmsh."""


def drawn(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A small valid problem of any physics, with pictures."""
    body, in_time = rng.random() < 0.4, rng.random() < 0.3
    names = rng.sample(TEXTS, rng.choice([0, 1, 2, 4]))
    geo = ['SetFactory("OpenCASCADE");', "Rectangle(1) = {0, 0, 0, 1, 1};", "Mesh.MeshSizeMin = 0.5;"]
    geo += [f'Physical Curve("{name}") = {{{number}}};' for number, name in enumerate(names, start=1)]
    region = rng.choice(TEXTS)
    (folder / "square.geo").write_text("\n".join([*geo, f'Physical Surface("{region}") = {{1}};']), encoding="utf-8")
    some = names[: rng.randrange(len(names) + 1)]
    lines = [f"title = {_toml(rng.choice([*TEXTS, *CONTROLS]))}", *['physics = "elasticity"'] * body]
    lines += ["[geometry]", 'file = "square.geo"', "[boundary]"]
    lines += [f"{'contact' if body else 'signorini'} = [{', '.join(map(_toml, some))}]"] * bool(some)
    lines += ["[problem]", *(["young = 1", "poisson = 0.3", "f = [0, -0.01]"] if body else ["f = -1", "psi = -0.05"])]
    lines += ["[time]", "end = 1", "steps = 2"] * in_time
    if not body:
        drawable = [text for text in TEXTS if len(text) <= 30 and text.isprintable()]
        lines += ["[plot]", *(f"{key} = {_toml(rng.choice(drawable))}" for key in ("u", "unit", "flux"))]
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    words = ["solve", "case.toml", "--output", OUTPUT, "--plot", *["--html"] * (not in_time)]
    about = f"{names}, contact on {len(some)} of them" + " in time" * in_time + " of a body" * body
    return Broken(words, about, solved=True, homeless=rng.random() < 0.5)


def _toml(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "")
