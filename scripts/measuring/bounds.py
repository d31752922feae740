"""What adaptive refinement gains, what cubics gain in bounds of bodies, and how far quadratic elements pass a bound."""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Annotated

import dolfinx.fem.petsc
import numpy as np
import typer
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc
from rich.console import Console
from rich.table import Table

from signorini_fenicsx import (
    Diffusion,
    Elasticity,
    Neumann,
    Signorini,
    adapt_case,
    certify,
    load_case,
    solve,
    solve_case,
)
from signorini_fenicsx.certificate.adaptive import ALONE, FIRST_MESH, AdaptRow
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.meshes.uniform import refined_uniformly
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.elasticity.bound import certify as bound
from signorini_fenicsx.physics.elasticity.bound import lifted
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.quantities import Energy, Flux, Integral, Kind, Mean, Quantity
from signorini_fenicsx.solving.solved import Solved

QUANTITIES: dict[str, Kind] = {
    "mean": Mean(),
    "far corner": Integral(weight="1 if x > 0.5 and y < 0.25 else 0"),
    "on bottom": Mean(parts="bottom"),
}
"""Quantities of example 5."""


def measured(solution: Solved, kind: Kind, *, of_energy: bool) -> Quantity:
    """A quantity; for the bound of the energy error without the shares of cells (collective)."""
    interval = solution.quantity(kind)
    return replace(interval, shares=None) if of_energy else interval


def coarse(name: str) -> Case:
    """A case with RT0 on the mesh from which adaptive runs start."""
    case = load_case(name)
    return case.with_values({"solve.h": shape_of(case.geometry.shape).diameter / FIRST_MESH, "solve.element": "RT0"})


def quantities(max_cells: Annotated[int, typer.Argument()] = 20_000) -> None:
    """Refinement for the interval of a quantity beside that for the energy error, and uniform one, in example 5.

    The table has cells of the first mesh whose interval is that short, and the seconds of all meshes up to it, each
    with its interval. Each length is what the last mesh for the energy bound reaches, times 1, 2 and 4.
    """
    case = coarse("example5")
    ways = {"interval": (False, 0.5), "energy": (True, 0.5), "uniform": (True, 1.0)}
    table = Table("quantity", "length", *(f"{way}: {what}" for way in ways for what in ("cells", "s")))
    for name, kind in QUANTITIES.items():
        rows: dict[str, list[AdaptRow]] = {}
        for way, (of_energy, theta) in ways.items():
            rows[way] = []
            measure = partial(measured, kind=kind, of_energy=of_energy)
            adapt_case(case, max_cells=max_cells, theta=theta, measure=measure, on_row=rows[way].append)
        last = rows["energy"][-1].quantities[ALONE].width
        for factor in (4, 2, 1):
            cells = []
            for of_way in rows.values():
                reached = next((row for row in of_way if row.quantities[ALONE].width <= factor * last), None)
                cells += ["–", "–"] if reached is None else [str(reached.cells), f"{reached.seconds:.1f}"]
            table.add_row(name, f"{factor * last:.2e}", *cells)
    if MPI.COMM_WORLD.rank == 0:
        Console(width=110).print(table)


def adaptive(
    max_cells: Annotated[int, typer.Argument()] = 200_000,
    cases: Annotated[list[str], typer.Argument()] = ["example2", "example5"],  # noqa: B006
) -> None:
    """Unknowns and seconds that adaptive refinement with RT0 needs for the certified error of uniform meshes.

    For each case uniform refinement runs up to MAX_CELLS. For each uniform mesh the table gives its certified relative
    error, then unknowns and seconds of

    - uniform: this mesh, the seconds of all meshes up to it, and those of this mesh alone,
    - adaptive: the first adaptive mesh with at most this error, and the seconds of all meshes up to it,

    and the ratios: of the unknowns, of the seconds, and of the seconds of the uniform mesh alone to those of all
    adaptive meshes. Each mesh starts from the contact set of the mesh before. A first run on small meshes compiles the
    forms and does not count.
    """
    columns = ("case", "error", "uniform", "seconds", "alone", "adaptive", "seconds", "ratios")
    table = Table(*columns)
    for name in cases:
        case, uniform, refined = coarse(name), list[AdaptRow](), list[AdaptRow]()
        adapt_case(case, max_cells=10_000)
        _, finest = adapt_case(case, max_cells=max_cells, theta=1.0, on_row=uniform.append)
        adapt_case(case, target=finest.relative, on_row=refined.append)
        for before, row in pairwise(uniform):
            reached = next(other for other in refined if other.relative <= row.relative)
            alone = row.seconds - before.seconds
            ratios = (row.unknowns / reached.unknowns, row.seconds / reached.seconds, alone / reached.seconds)
            table.add_row(
                name,
                f"{row.relative:.2e}",
                str(row.unknowns),
                f"{row.seconds:.1f}",
                f"{alone:.1f}",
                str(reached.unknowns),
                f"{reached.seconds:.1f}",
                "  ".join(f"{ratio:.1f}" for ratio in ratios),
            )
    if MPI.COMM_WORLD.rank == 0:
        Console(width=100).print(table)


COMM = MPI.COMM_SELF
KINDS = {"as it is": (2, bound.MANY), "quadratics": (2, {2: 0}), "cubics": (3, {2: 0})}
"""Degree of v on all cells, and on how many it may be higher."""


def solutions() -> Iterator[tuple[str, ElasticSolution]]:
    """The solutions with their names."""
    load = ["2*y*(1 - y) + x*(1 - x)", "-(1 - 2*x)*(1 - 2*y)/2"]
    smooth = Elasticity(1.0, 0.0, f=load, exact=["x*(1 - x)*y*(1 - y)", "0"])
    for h in (2**-3, 2**-5):
        domain = build_domain(COMM, "square", h, mesh="structured")
        yield "smooth", solve(domain, smooth.on(domain))
    case = load_case("hertz")
    for h in ("2^-4", "2^-6"):
        yield "hertz", solve_case(case.with_values({"solve.h": h}), COMM)
    for name, target in (("hertz", 2e-3), ("two_cylinders", 8e-3)):
        yield f"{name}, adapted", adapt_case(load_case(name).with_values({"solve.h": 0.125}), COMM, target=target)[0]


def cubics() -> None:
    """Bounds of bodies in the plane by the v of the program, with quadratics alone, and with cubics alone.

    A row has the cells, the bound of ‖σ − σ_h‖ and the seconds of the processor for it, by each v; and the error if it
    is known. The meshes are uniform or adapted; see `physics.elasticity.bound.certify`.
    """
    print(f"{'':24s}{'cells':>6s}", *(f"{kind:>20s}" for kind in KINDS), f"{'error':>10s}")
    for name, solution in solutions():
        row, errors = f"{name:24s}{solution.spaces.domain.cells:6d}", solution.errors()
        for degree, bound.MANY in KINDS.values():
            bound.degree_of = lifted.degree_of = lambda _, degree=degree: degree
            certify(solution)
            began = time.process_time()
            row += f" {certify(solution).sigma_bound:11.3e} {time.process_time() - began:6.2f} s"
        print(row, f"{errors['energy']:10.3e}" if errors else "", flush=True)


MOST = 500
"""Most iterations of SNES."""
SIDE, NOISE = 9, 1e-14
"""Points of a cell divide its edges into so many pieces; what is no more below 0 than the second is rounding."""


def u_D(x: np.ndarray) -> np.ndarray:
    """The levels: w on the boundary."""
    return (1 - x[0] / 1.62) * (3.22 - x[1]) ** 2 / 2 + x[0] / 1.62 * np.maximum(0.84 - x[1], 0) ** 2 / 2


def quadratic(domain: Domain) -> fem.Function:
    """The w of quadratic elements with w ≥ 0 in their nodes."""
    mesh = domain.mesh
    space = fem.functionspace(mesh, ("Lagrange", 2))
    u, v, w = ufl.TrialFunction(space), ufl.TestFunction(space), fem.Function(space, name="w")
    lifted = fem.Function(space)
    lifted.interpolate(u_D)
    mesh.topology.create_connectivity(1, 2)
    outer = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    fixed = [fem.dirichletbc(lifted, fem.locate_dofs_topological(space, 1, outer))]
    form = fem.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
    A = dolfinx.fem.petsc.assemble_matrix(form, bcs=fixed)
    A.assemble()
    b = dolfinx.fem.petsc.assemble_vector(fem.form(-1.0 * v * ufl.dx))
    dolfinx.fem.petsc.apply_lifting(b, [form], bcs=[fixed])
    dolfinx.fem.petsc.set_bc(b, fixed)
    snes = PETSc.SNES().create(mesh.comm)
    snes.setType("vinewtonrsls")
    snes.setFunction(lambda _, x, out: out.waxpy(-1.0, b, A * x), b.duplicate())
    snes.setJacobian(lambda *_: None, A)
    least, most = b.duplicate(), b.duplicate()
    least.set(0.0)
    most.set(PETSc.INFINITY)
    snes.setVariableBounds(least, most)
    snes.setTolerances(atol=1e-12, rtol=1e-12, max_it=MOST)
    snes.getKSP().setType("preonly")
    snes.getKSP().getPC().setType("lu")
    x = b.duplicate()
    snes.solve(None, x)
    w.x.array[:] = x.array
    if snes.getConvergedReason() <= 0:
        raise SystemExit(f"error: SNES does not converge, reason {snes.getConvergedReason()}")
    return w


def orders() -> None:
    """How half the length of some intervals shrinks with h (collective)."""
    problem = Diffusion(f="-10 if x < 0.5 else 10", conditions=[Signorini("bottom"), Neumann("right")])
    kinds = [Integral(weight="1 if x < 0.5 else 0"), Mean(), Flux(["left", "bottom", "top"]), Energy()]
    for n in (16, 32, 64, 128):
        solution = solve(build_domain(MPI.COMM_WORLD, "square", 1.001 * 2**0.5 / n, mesh="structured"), problem)
        intervals = [solution.quantity(kind) for kind in kinds]
        if MPI.COMM_WORLD.rank == 0:
            print(f"{n:4d} " + "  ".join(f"{each.middle:.6f} ± {each.width / 2:.2e}" for each in intervals), flush=True)


def finer(domain: Domain, w: fem.Function, levels: int) -> tuple[Domain, fem.Function]:
    """The mesh refined so often, and w on it, where it is the same function."""
    for _ in range(levels):
        domain = refined_uniformly(domain)
    mesh = domain.mesh
    fine = fem.Function(fem.functionspace(mesh, ("Lagrange", 2)))
    cells = np.arange(domain.cells, dtype=np.int32)
    search = fem.create_interpolation_data(fine.function_space, w.function_space, cells, padding=1e-12)
    fine.interpolate_nonmatching(w, cells, search)
    return domain, fine


def quadratics(
    h: str = "0.16", refine: Annotated[int, typer.Option(help="How often the mesh is refined for the bounds.")] = 2
) -> None:
    """How far quadratic elements pass a bound that holds in their nodes, and how wrong they are.

    Muskat's dam, w ≥ 0: continuous quadratic elements with w ≥ 0 in all nodes, by PETSc's vinewtonrsls, which issue
    30098 of MOOSE is about. It prints the smallest w in 55 points of each cell, the share of the points where w < 0,
    and bounds of the energy error of w, by a flux on a mesh that is refined so often. Then it prints the smallest mean
    of w in a cell by the method of this program on the first mesh, and the bound of its error.
    """
    case = load_case("muskat").with_values({"solve.h": h})
    solution = solve_case(case)
    domain = solution.spaces.domain
    w = quadratic(domain)
    places = np.array([[i, j] for i in range(SIDE + 1) for j in range(SIDE + 1 - i)]) / SIDE
    shapes = w.function_space.element.basix_element.tabulate(0, places)[0, :, :, 0]
    values = shapes @ w.x.array[w.function_space.dofmap.list].T
    refined, v = finer(domain, w, refine)
    of_v, ours = certify(solve_case(case, domain=refined), v=v), certify(solution)
    print(f"{domain.cells} triangles, {len(w.x.array)} quadratic unknowns, {solution.outcome.dofs} of this program")
    print(f"quadratic: w ≥ {w.x.array.min():.1e} in nodes, {values.min():.1e} in points", end="")
    print(f", w < 0 in {100 * (values < -NOISE).mean():.1f} % of the points")
    print(f"           {of_v.lower:.3g} ≤ energy error ≤ {of_v.bound:.3g}, {of_v.repair:.2g} from w ≥ 0 and u_D")
    print(f"here:      w ≥ {solution.u.x.array.min():.1e} as means, energy error ≤ {ours.bound:.3g}")
