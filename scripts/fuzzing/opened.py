"""Predictions and starts that end open, for what contact alone holds along an axis: each has a solution."""

import random
from pathlib import Path

from fuzzing.broken import OUTPUT, Broken, Valid

GAPS = ("0", "0", "0.01*x", "max(0, x - 0.4)/50", "0.1*(x - 0.3)^2", "0.002*(1 - cos(20*x))", "0.3")
FRICTION = ("mu = 0.3", "g = 0.01", 'g = "0.02*x"')
LIFTED = """physics = "elasticity"
[geometry]
shape = "square"
[boundary]
contact = ["bottom"]
neumann = ["left", "right"]
[problem]
young = 1
poisson = 0.3
f = [0, 0]
u_D = [0, 0.1]
[solve]
h = 0.5
"""
"""A body without contact, from which others start."""


def opened(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """Loads that press on the whole, and lift some of it; in steps they press and lift in turn."""
    body, way = rng.random() < 0.6, rng.choice(["predicted", "start", "start", "steps"])
    size, tilt = 10 ** rng.uniform(-4, -1), rng.choice([0, 2, rng.uniform(-40, 40)])
    load = f"{-size}*(1 + {tilt}*(x - 0.5))" if way != "steps" else f"{size}*cos(pi*t)*(1 + {tilt}*(x - 0.5))"
    lines = ["[geometry]", 'shape = "square"', f'mesh = "{rng.choice(["structured", "unstructured"])}"', "[boundary]"]
    if body:
        loads = [f'f = [0, "{load}"]', f'g_N = {{top = ["0", "{load}"]}}']
        lines = ['physics = "elasticity"', *lines, 'contact = ["bottom"]', 'neumann = ["top", "right"]']
        lines += [f'fixed = {{left = "{"xy" if way == "steps" else "x"}"}}']
        if rng.random() < 0.3:
            lines += ["[[law]]", 'kind = "friction"', 'parts = ["bottom"]', rng.choice(FRICTION)]
        lines += ["[problem]", "young = 1", f"poisson = {rng.choice([0, 0.3, 0.45])}", f'gap = "{rng.choice(GAPS)}"']
        lines += rng.choice([loads[:1], loads]) if way == "steps" else rng.choice([loads[:1], ["f = [0, 0]", loads[1]]])
    else:
        lines += ['signorini = ["bottom"]', 'neumann = ["left", "right", "top"]', "[problem]"]
        lines += [f'psi = "-({rng.choice(GAPS)})"', f'f = "{load}"']
    lines += ["[time]", "end = 3", "steps = 3"] if way == "steps" else []
    lines += ["[solve]", f"h = {rng.uniform(0.031, 0.034) if way == 'predicted' else rng.uniform(0.1, 0.4)}"]
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    words = ["solve", "case.toml", "--output", OUTPUT]
    words += ["--start-from", str(valid.opened if body else valid.shape)] if way == "start" else []
    return Broken(words, f"{way}: {'; '.join(lines)}"[:400], solved=True, bounded=way != "steps")
