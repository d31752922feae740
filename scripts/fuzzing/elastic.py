"""Elastic contact of few facets: bodies that one vertex, a corner, a groove or friction alone may hold."""

import random
from pathlib import Path

from fuzzing.broken import OUTPUT, Broken, Valid

BODIES = (
    ("square", ("bottom", "left", "right", "top"), 2),
    ("half_disk", ("arc", "diameter"), 2),
    ("lshape", ("bottom", "left", "right", "top"), 2),
    ("cube", ("bottom", "top", "left", "right", "front", "back"), 3),
)
GAPS = ("0", "0.01", "2*x^2", "5*(x - 0.3)^2", "1 if x > 0.4 else 0", "0.1*abs(x - 0.4)", "-0.01", "x/9")
POISSON = ("0", "0.3", "0.49", "0.4999999", "-0.5")
LOADS = ("0", "-0.02", "0.02", "-0.3", "-0.01*x", "0.05*(x - 0.5)", "sin(9*x)/50")
FEW = (0.36, 0.5, 0.8, 1.5)
"""Values of h in the plane; with these there are one to six facets of Γ_C on a side."""


def few_facets(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A valid case with few facets in contact; it may have no solution, but no bound of it may be beyond all sense."""
    shape, parts, dim = rng.choice(BODIES[:3] * 3 + BODIES[3:])
    order = rng.sample(parts, len(parts))
    number = rng.choice([1, 1, 2])
    contact, others = order[:number], order[number:]
    loaded = others[: rng.randrange(len(others) + 1)]
    held = [part for part in others if part not in loaded]
    fixed = {part: rng.choice(["x", "y", "n", "xy"]) for part in held if rng.random() < 0.6}

    def vector(entries: tuple[str, ...]) -> str:
        return "[" + ", ".join(f'"{rng.choice(entries)}"' for _ in range(dim)) + "]"

    lines = ['physics = "elasticity"', "[geometry]", f'shape = "{shape}"']
    lines += ["[boundary]", f"contact = {contact}", f"neumann = {loaded}"]
    lines += ["fixed = {" + ", ".join(f'{part} = "{way}"' for part, way in fixed.items()) + "}"]
    if dim == 2 and rng.random() < 0.3:
        bound = rng.choice(["mu = 0.3", "mu = 0.05", "mu = 0.9", "g = 0.004", 'g = "0.01*x^2"'])
        lines += ["[[law]]", 'kind = "friction"', f"parts = {contact[:1]}", bound]
    lines += ["[problem]", "young = 1", f"poisson = {rng.choice(POISSON)}", f'gap = "{rng.choice(GAPS)}"']
    lines += [f"f = {vector(LOADS[:3])}", f"u_D = {vector(('0', '0', '-0.01', '0.01*y'))}"]
    lines += [f"g_N = {{{loaded[0]} = {vector(LOADS)}}}"] if loaded else []
    lines += ["[solve]", f"h = {rng.choice(FEW) if dim == 2 else 1.7}"]
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    about = f"{shape}, contact on {', '.join(contact)}, loads on {', '.join(loaded)}, fixed {fixed}"
    return Broken(["solve", "case.toml", "--output", OUTPUT], about[:120], bounded=True)
