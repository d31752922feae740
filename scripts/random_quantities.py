"""Tests intervals of quantities on random problems against solutions on a mesh 4 times as fine: never outside.

uv run python scripts/random_quantities.py --seeds 60        (also under mpirun)
uv run python scripts/random_quantities.py --bodies --seeds 30   of elastic bodies, on a mesh half or a third as fine
uv run python scripts/random_quantities.py --exact --seeds 40   jumps and kinks, against exact values
uv run python scripts/random_quantities.py --orders          how intervals shrink with h

A seed chooses a shape, a load, κ, laws on parts of the boundary and in Ω, and a quantity; of a body its friction, loads
and contact. A row has the interval, and
that on the finer mesh (in space 3 times as fine). The exact value is in both; if they do not meet, one of them is
wrong. The centre of the finer one is expected in the coarser one, unless both are about as long. The value is that of
the discrete solution itself: of fluxes, and of integrals with a number as weight over Ω, it is summed here once more.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import argparse
import math
from dataclasses import dataclass

import numpy as np
from exact_quantities import balanced, bar, membrane
from mpi4py import MPI

from signorini_fenicsx import (
    Contact,
    Corners,
    Diffusion,
    Dirichlet,
    Elasticity,
    Friction,
    Neumann,
    Obstacle,
    Reaction,
    Regulator,
    River,
    Seepage,
    Signorini,
    Solution,
    Tresca,
    TwoSided,
    Wall,
    solve,
)
from signorini_fenicsx.base.parallel import collect_garbage
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.meshes.shapes import SHAPES
from signorini_fenicsx.quantities import Energy, Flux, Force, Integral, Kind, Mean, Moment, Quantity

LAWS = {
    "signorini": lambda part, a, b: Signorini(part, psi=f"{-abs(a) / 10} + {b / 40}*x*y", q_S=b / 4),
    "friction": lambda part, a, b: Friction(part, g=f"{abs(a) / 2} + 0.1*x"),
    "two-sided": lambda part, a, b: TwoSided(part, psi=-abs(a) / 10, psi_upper=abs(b) / 10),
    "wall": lambda part, a, b: Wall(part, beta=abs(a), level=b / 20),
    "regulator": lambda part, a, b: Regulator(part, k=1 + abs(a), g_low=-abs(b) / 4, g_high=abs(a) / 4, a=b / 20),
    "seepage": lambda part, a, b: Seepage(part, rain=a / 4, level=abs(b) / 20),
    "river": lambda part, a, b: River(part, r=1 + abs(a), level=0.1 + b / 40, bed=-0.1 - abs(a) / 40),
    "graph": lambda part, a, b: Corners(part, [(-0.1, abs(a) / 4), (0.05, 0), (0.05, -abs(b) / 4)], before=1),
}
"""Laws on a part, from two random numbers."""
ROUNDING = 1e-12
"""Of an exact value."""
INSIDE = {
    "obstacle": lambda a, b: Obstacle(region="all", psi=-abs(a) / 20, psi_upper=abs(b) / 20 + 0.1),
    "reaction": lambda a, b: Reaction(region="all", c=f"{abs(a)} + x"),
    "graph": lambda a, b: Corners([(-0.1, -abs(a)), (0.0, 0.0), (0.0, abs(b)), (0.2, 2 * abs(b))], region="all"),
}
"""Laws in Ω."""


@dataclass(frozen=True)
class Row:
    """A quantity of a random problem on two meshes.

    Attributes:
        seed: The seed.
        what: The problem in words.
        kind: The quantity.
        coarse: Its interval.
        fine: That on the finer mesh.
        itself: What σ_h or u_h of the coarse solution have, where it is a flux, or an integral of u alone over Ω.
    """

    seed: int
    what: str
    kind: Kind
    coarse: Quantity
    fine: Quantity
    itself: float | None = None

    @property
    def holds(self) -> bool:
        """Whether both can be true, and the centre of the finer one is where it is expected."""
        meet = max(self.coarse.lower, self.fine.lower) <= min(self.coarse.upper, self.fine.upper)
        narrow = self.fine.width < self.coarse.width / 2
        is_value = self.itself is None or abs(self.coarse.value - self.itself) <= 1e-9 * (1 + abs(self.itself))
        return is_value and meet and (not narrow or self.coarse.lower <= self.fine.middle <= self.coarse.upper)

    @property
    def found(self) -> bool:
        """Whether there is an interval."""
        return math.isfinite(self.coarse.width)

    def __str__(self) -> str:
        ends = " in ".join(f"[{each.lower:.6g}, {each.upper:.6g}]" for each in (self.fine, self.coarse))
        verdict = "holds" if self.holds else "OUTSIDE"
        return f"{self.seed:4d} {self.what:40s} {type(self.kind).__name__:8s} {ends} {verdict} {self.coarse.reason}"


def random_row(seed: int, shapes: tuple[str, ...] = ("square", "lshape", "cube")) -> Row:
    """The row of a seed (collective)."""
    rng = np.random.default_rng(seed)
    shape = str(rng.choice(shapes))
    parts = rng.permutation(list(SHAPES[shape].parts)).tolist()
    a, b, c, d = np.round(rng.uniform(-4, 4, 4), 3).tolist()
    laws = rng.choice(list(LAWS), 2).tolist()
    conditions = [LAWS[laws[0]](parts[0], a, b), LAWS[laws[1]](parts[1], c, d)]
    if rng.random() < 0.5:
        conditions.append(Neumann(parts[2], f"{d / 4}*x"))
    inside = str(rng.choice(["", "", *INSIDE]))
    if inside:
        conditions.append(INSIDE[inside](a, d))
    load = str(rng.choice([f"{4 * a}*sin({b}*x + {c}*y)", f"{4 * c} + {3 * b}*x", f"{8 * a} if x > 0.3 else {6 * d}"]))
    kappa = str(rng.choice(["1", "1 + x^2", "2 + sin(3*y)"]))
    kinds = [
        Mean(),
        Integral(weight="1 if x < 0.4 else 0"),
        Integral(weight=f"{a} + y", parts=parts[0]),
        Flux(parts[0]),
        Flux(parts[:2]),
    ]
    if all(law == "signorini" for law in laws) and not inside:
        kinds.append(Energy())
    kind = kinds[rng.integers(len(kinds))]
    problem = Diffusion(f=load, kappa=kappa, conditions=conditions)
    h, finer = (float(rng.uniform(0.35, 0.6)), 3) if shape == "cube" else (float(rng.uniform(0.12, 0.25)), 4)
    mesh = str(rng.choice(["structured", "unstructured"]))
    solutions = [solve(build_domain(MPI.COMM_WORLD, shape, size, mesh=mesh), problem) for size in (h, h / finer)]
    intervals = [solution.quantity(kind) for solution in solutions]
    return Row(
        seed, f"{shape}, {', '.join(laws)}, {inside or 'no law'} in Ω", kind, *intervals, _itself(solutions[0], kind)
    )


def _itself(solution: Solution, kind: Kind) -> float | None:
    """What σ_h or u_h have of a quantity, where it is a flux or an integral of u alone over Ω (collective)."""
    if isinstance(kind, Flux):
        return solution.flux_through(list(kind.parts))
    if not isinstance(kind, Mean) or kind.parts or kind.weight != 1:
        return None
    measures = solution.spaces.cell_measures
    sums = solution.spaces.mesh.comm.allreduce(
        np.array([measures @ solution.u.x.array[: len(measures)], measures.sum()])
    )
    return float(sums[0] / sums[1])


def random_body(seed: int, shapes: tuple[str, ...] = ("square", "square", "cube")) -> Row:
    """The row of a seed for an elastic body that is pressed onto a foundation (collective)."""
    rng = np.random.default_rng(seed)
    shape = str(rng.choice(shapes))
    dim = 3 if shape == "cube" else 2
    a, b, c, d = np.round(rng.uniform(-1, 1, 4), 3).tolist()
    friction = [None, Tresca(abs(b) / 20), Tresca(f"{abs(a) / 40} + 0.01*x")][rng.integers(3)]
    touching = [
        Contact("bottom", gap=f"{abs(a) / 40}*(1 + {c}*x)", friction=friction),
        Wall("bottom", beta=1 + abs(a), level=b / 20),
        Signorini("bottom", psi=-abs(b) / 20),
    ][rng.integers(3)]
    none = [0] * (dim - 2)
    sides = [part for part in SHAPES[shape].parts if part not in ("top", "bottom")]
    loads = Neumann(sides, [f"{c / 20}*{'xyz'[dim - 1]}", *none, d / 40])
    top = Dirichlet("top", [f"{d / 20}", *none, f"-0.05 + {a / 40}*x"])
    along = np.eye(dim)[[0, dim - 1]].tolist()[rng.integers(2)]
    kinds = [
        Mean(direction=along),
        Integral(direction=along, weight="1 if x < 0.4 else 0"),
        Mean(direction=along, parts="right"),
        Mean(direction=along, parts="bottom"),
        Integral(parts="bottom", weight="1 + x^2"),
        Force("top", along),
        Force("bottom", along),
        Moment("bottom", None if dim == 2 else [0, 1, 0]),
        Energy(),
    ]
    kind = kinds[rng.integers(len(kinds))]
    body = Elasticity(1.0, float(rng.uniform(0, 0.4)), f=[a / 10, *none, b / 10], conditions=[touching, top, loads])
    h, finer = (float(rng.uniform(0.9, 1.8)), 2) if dim == 3 else (float(rng.uniform(0.3, 0.5)), 3)
    intervals = [
        solve(build_domain(MPI.COMM_WORLD, shape, size, mesh="structured"), body).quantity(kind)
        for size in (h, h / finer)
    ]
    rubs = "" if not isinstance(touching, Contact) or friction is None else " with friction"
    return Row(seed, f"{shape}, {type(touching).__name__.lower()}{rubs}", kind, *intervals)


def against_exact(seed: int) -> list[tuple[str, bool, bool]]:
    """Some quantities of a random problem with known ones: in words, whether guaranteed, and inside (collective)."""
    rng = np.random.default_rng(seed)
    made = (membrane, bar, balanced)[seed % 3](rng)
    h, mesh = float(rng.uniform(0.15, 0.3)), str(rng.choice(["structured", "unstructured"]))
    solution, rows = solve(build_domain(MPI.COMM_WORLD, "square", h, mesh=mesh), made.problem), []
    for kind, known in made.kinds:
        found = solution.quantity(kind)
        inside = found.lower - ROUNDING * (1 + abs(known)) <= known <= found.upper + ROUNDING * (1 + abs(known))
        verdict = f"{'holds' if inside else 'OUTSIDE'} {found.reason or 'guaranteed'}"
        words = f"{seed:4d} {type(kind).__name__:8s} {known:.9g} in [{found.lower:.9g}, {found.upper:.9g}] {verdict}"
        rows.append((words, found.guaranteed, inside))
    return rows


def orders() -> None:
    """Print half the length of some intervals on finer and finer meshes (collective)."""
    problem = Diffusion(f="-10 if x < 0.5 else 10", conditions=[Signorini("bottom"), Neumann("right")])
    kinds = [Integral(weight="1 if x < 0.5 else 0"), Mean(), Flux(["left", "bottom", "top"]), Energy()]
    for n in (16, 32, 64, 128):
        solution = solve(build_domain(MPI.COMM_WORLD, "square", 1.001 * 2**0.5 / n, mesh="structured"), problem)
        intervals = [solution.quantity(kind) for kind in kinds]
        if MPI.COMM_WORLD.rank == 0:
            print(f"{n:4d} " + "  ".join(f"{each.middle:.6f} ± {each.width / 2:.2e}" for each in intervals), flush=True)


def main() -> None:
    """Print the rows and how many hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--bodies", action="store_true")
    parser.add_argument("--exact", action="store_true")
    parser.add_argument("--orders", action="store_true")
    arguments = parser.parse_args()
    if arguments.orders:
        orders()
        return
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    if arguments.exact:
        exact = []
        for seed in seeds:
            exact += (found := against_exact(seed))
            collect_garbage(MPI.COMM_WORLD)
            if MPI.COMM_WORLD.rank == 0:
                print("\n".join(words for words, *_ in found), flush=True)
        proved = [inside for _, guaranteed, inside in exact if guaranteed]
        if MPI.COMM_WORLD.rank == 0:
            print(f"{len(exact)} quantities, {len(proved)} guaranteed, {proved.count(False)} of these outside")
        return
    rows = []
    for seed in seeds:
        rows.append(random_body(seed) if arguments.bodies else random_row(seed))
        collect_garbage(MPI.COMM_WORLD)
        if MPI.COMM_WORLD.rank == 0:
            print(rows[-1], flush=True)
    bounded, wrong = sum(row.found for row in rows), [row.seed for row in rows if not row.holds]
    if MPI.COMM_WORLD.rank == 0:
        print(f"{len(rows)} problems, {bounded} with an interval, {len(wrong)} outside {wrong or ''}")


if __name__ == "__main__":
    main()
