"""Rectangles far from the origin, thin, large and small; all of one side is in contact, whose measure is known."""

import math
import random
from pathlib import Path

from fuzzing.broken import OUTPUT, Broken, Valid

FAR = (0.0, 0.0, 1.0, 1e2, 1e4, 5e5, 4e6, 1e8, 1e12, 1e15)
DIGITS = 1e-9
"""A rectangle whose smaller side is this share of its coordinates or more is to be solved."""


def far_place(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A body pressed onto one side of a rectangle, of any physics."""
    size = 10 ** rng.uniform(-6, 6)
    sides = [size, size * 10 ** rng.choice([0, 0, rng.uniform(-8, 0), rng.uniform(0, 2)])]
    rng.shuffle(sides)
    begins = [rng.choice((-1, 1)) * far * rng.choice([1, 1, size]) for far in rng.choices(FAR, k=2)]
    ends = [begin + side for begin, side in zip(begins, sides, strict=True)]
    real = [end - begin for begin, end in zip(begins, ends, strict=True)]
    shape = " x ".join(f"[{begin!r}, {end!r}]" for begin, end in zip(begins, ends, strict=True))
    part = rng.choice(["bottom", "top", "left", "right"])
    along, across = real if part in ("bottom", "top") else real[::-1]
    others = [side for side in ("bottom", "top", "left", "right") if side != part]
    opposite = {"bottom": "top", "top": "bottom", "left": "right", "right": "left"}[part]
    free = [side for side in others if side != opposite]
    lines = ["[geometry]", f'shape = "{shape}"', f'mesh = "{rng.choice(["structured", "unstructured"])}"']
    if rng.random() < 0.4:
        sign = -1 if part in ("bottom", "left") else 1
        push = [0.0, 0.0]
        push[part in ("bottom", "top")] = sign * 1e-3 * across
        lines = ['physics = "elasticity"', *lines, "[boundary]", f'contact = ["{part}"]', f"neumann = {free}"]
        lines += ["[problem]", "young = 1", "poisson = 0", f"u_D = {[repr(value) for value in push]}"]
    else:
        lines += ["[boundary]", f'signorini = ["{part}"]', f"neumann = {free}"]
        lines += ["[problem]", "f = 0", f"u_D = {-across!r}"]
    lines += ["[solve]", f"h = {max(min(real) / 3, max(real) / 40)!r}"]
    (folder / "case.toml").write_text("\n".join(lines).replace("'", '"') + "\n", encoding="utf-8")
    share = min(real) / max(map(abs, (*begins, *ends)))
    solved = share > DIGITS and max(real) <= 100 * min(real)
    contact = along if math.isfinite(along) and along > 0 else None
    words = ["solve", "case.toml", "--output", OUTPUT]
    return Broken(words, f"{shape}, {part}", solved=solved, contact=contact)
