"""Makes random problems, solves them, and looks for what is wrong: exit status 1 if anything is.

    uv run python scripts/random_runs.py KIND [--seeds 60] [--first 0]          (some also under mpirun)

`problems`  scalar problems against SNESVI or SNES
`laws`      with several laws on Γ_S against a quadratic programme; `laws-inside` with laws in Ω too
`bounds`    certified bounds against solutions on the mesh refined twice, κ with jumps at cells; `bounds-smooth` without
            jumps, `bounds-across` with jumps in cells, `bounds-RT1` by fluxes of order two, `small` with κ near 0
`elasticity`  all that elastic problems take: two algorithms, the balance, and bounds against adaptive meshes; `pairs`
            of bodies with meshes of their own, `rough` data, `flows`
`quantities`  intervals of quantities against those on finer meshes; `quantities-bodies` of elastic bodies, `exact`
            against exact values
`first`     shipped cases with other numbers, by the default options

A seed determines a problem. Each prints a line, or only those that are wrong do; then come counts, and the least, the
median and the largest of some numbers.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import argparse
import sys
import time
from collections import Counter
from functools import partial
from importlib import import_module

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.parallel import collect_garbage

KINDS = {
    "problems": ("scalar", "random_scalar"),
    "laws": ("scalar", "random_scalar", True),
    "laws-inside": ("scalar", "random_scalar", True, True),
    "bounds": ("bounds", "bound", "aligned"),
    "bounds-smooth": ("bounds", "bound", "none"),
    "bounds-across": ("bounds", "bound", "across"),
    "bounds-RT1": ("bounds", "bound", "aligned", "RT1"),
    "small": ("bounds", "small"),
    **{name: ("bodies", "random_body", name) for name in ("elasticity", "pairs", "rough", "flows")},
    "quantities": ("quantities", "of_random"),
    "quantities-bodies": ("quantities", "of_random", True),
    "exact": ("quantities", "of_exact"),
    "first": ("first", "first_problem"),
}
"""For each kind a module of `makers`, its function, and what this takes besides the seed."""


def main() -> None:
    """Go through the seeds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--seeds", type=int, default=60, help="number of problems")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    asked = parser.parse_args()
    module, name, *given = KINDS[asked.kind]
    make = getattr(import_module(f"makers.{module}"), name)
    say = partial(print, flush=True) if MPI.COMM_WORLD.rank == 0 else lambda *_: None
    counts, numbers, began = Counter[str](), dict[str, list[float]](), time.monotonic()
    number, seed = 0, asked.first
    while number < asked.seeds:
        results = make(seed, *given)
        collect_garbage(MPI.COMM_WORLD)
        for found in results:
            counts.update([*found.counts, *["WRONG"] * found.wrong])
            for what, value in found.numbers.items():
                numbers.setdefault(what, []).append(value)
            if found.shown or found.wrong:
                say(f"{seed:4d} {'WRONG ' * found.wrong}{found.words}")
        number, seed = number + bool(results), seed + 1
    say(f"{number} seeds, {time.monotonic() - began:.0f} s: {dict(counts)}")
    for what, values in numbers.items():
        say(f"{what}: {np.min(values):.4g} to {np.max(values):.4g}, median {np.median(values):.4g} of {len(values)}")
    sys.exit(counts["WRONG"] > 0)


if __name__ == "__main__":
    main()
