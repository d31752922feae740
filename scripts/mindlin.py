"""The case mindlin3d, a sphere that is pressed onto a block and pushed sideways, beside the theory of half-spaces.

For each step: Q/μP; the radius of contact, the largest pressure and how deep the sphere goes, over those of Hertz; the
radius of what sticks, its value by Mindlin, and how far the sphere goes sideways over that by Mindlin; and what the
pressure and the shear are off, as shares of P and of μP. A last line has δ(last) − δ(first)Q(last)/Q(first) of the way
sideways over its value by theory, in which there is no part that is linear in Q, as that of the block as a whole.

Usage: python scripts/mindlin.py [--near H]
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from signorini_fenicsx import evolve_case, load_case
from signorini_fenicsx.base.arrays import Array

RADIUS, YOUNG, POISSON, MU, FORCE = 8.0, 1.0, 0.49, 0.3, 0.219332
NEAR = "near = 0.2;"
"""The size of cells in the mesh of the case."""


def ellipse(r: Array, radius: float) -> Array:
    """√(1 − r²/a²) for r < a, 0 beyond."""
    return np.sqrt(np.maximum(1 - (r / radius) ** 2, 0))


def theory(push: float) -> dict[str, float]:
    """By Hertz, Cattaneo and Mindlin, for Q/μP."""
    a = (3 * FORCE * RADIUS * (1 - POISSON**2) / (4 * YOUNG)) ** (1 / 3)
    c, shear_modulus = a * (1 - push) ** (1 / 3), YOUNG / (2 * (1 + POISSON))
    way = 3 * MU * FORCE * (2 - POISSON) / (16 * shear_modulus * a) * (1 - (c / a) ** 2)
    return {"a": a, "p0": 3 * FORCE / (2 * np.pi * a**2), "c": c, "depth": a**2 / RADIUS, "way": way}


def steps(case: Any) -> Iterator[dict[str, float]]:
    """What is found in each step, in units of theory, and what sticks; the body and the sphere are halves."""
    for instant in evolve_case(case):
        solution = instant.solution
        push = -solution.resultants()["bottom"][0] / (MU * FORCE / 2)
        expected = theory(push)
        a, c, p0 = (expected[name] for name in ("a", "c", "p0"))
        r = np.linalg.norm(solution.spaces.contact.vertices[:, :, :2], axis=2)
        measure = solution.spaces.site_kinds["normal"].measure.reshape(-1, 3)
        shear = MU * p0 * (ellipse(r, a) - c / a * ellipse(r, c))[:, :, None] * [1, 0, 0]
        moved = solution.quantities()["tools"]["contact"]["displacement"]
        off = np.abs(solution.pressure - p0 * ellipse(r, a)), np.linalg.norm(solution.shear_vectors - shear, axis=2)
        yield {
            "push": push,
            "radius": np.sqrt(2 * solution.contact.measure / np.pi) / a,
            "peak": solution.pressure.max() / p0,
            "depth": -moved["z"] / expected["depth"],
            "sticks": np.sqrt(2 * solution.friction_states()["stick"]["measure"] / np.pi),
            "c": c,
            "moved": moved["x"],
            "way": expected["way"],
            "off_pressure": (measure * off[0]).sum() / (FORCE / 2),
            "off_shear": (measure * off[1]).sum() / (MU * FORCE / 2),
        }


def main() -> None:
    """Print a line for each step."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--near", type=float, help="size of the cells where both touch, 0.2 in the case")
    near, case = parser.parse_args().near, load_case("mindlin3d")
    sys.stdout.write("Q/muP  radius  peak   depth  sticks  c      moved  off pressure, shear\n")
    with TemporaryDirectory() as folder:
        if near is not None:
            finer = Path(folder, "block.geo")
            finer.write_text(Path(case.geometry.file).read_text(encoding="utf-8").replace(NEAR, f"near = {near};"))
            case = case.with_values({"geometry.file": str(finer)})
        rows = []
        for row in steps(case):
            rows.append(row)
            moved = row["moved"] / row["way"] if row["push"] > 0.01 else np.nan
            line = (
                f"{row['push']:5.3f}  {row['radius']:.3f}   {row['peak']:.3f}  {row['depth']:.3f}  {row['sticks']:.3f}"
            )
            line += f"   {row['c']:.3f}  {moved:.3f}  {row['off_pressure']:.3f}         {row['off_shear']:.3f}\n"
            sys.stdout.write(line)
    first, last = rows[1], rows[-1]
    share = last["push"] / first["push"]
    bent = [last[name] - share * first[name] for name in ("moved", "way")]
    sys.stdout.write(f"what is not linear of the way: {bent[0] / bent[1]:.3f} of that by theory\n")


if __name__ == "__main__":
    main()
