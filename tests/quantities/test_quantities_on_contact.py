"""Displacements over parts in contact, forces on curved foundations, and bodies under tools: around known values."""

import pytest
from elastic import box, half_plane_contact, two_boxes
from mpi4py import MPI

from signorini_fenicsx import Contact, Dirichlet, Elasticity, Neumann, Pressure, Tresca, solve
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.elasticity.quantities.brackets import Fluxes
from signorini_fenicsx.quantities import Energy, Force, Integral, Kind, Mean, Moment, Quantity

COMM = MPI.COMM_WORLD


def around(found: Quantity, known: float, width: float) -> bool:
    """Whether an interval of at most this length has this value in it, but for rounding."""
    return found.lower - 1e-9 <= known <= found.upper + 1e-9 and found.width <= width


def test_where_contact_ends():
    """∫ u_n of a known solution that lifts off for x < 0.07; the interval shrinks faster than h."""
    u, widths = half_plane_contact(0.3), []
    known = -2.8 * 2.6 / 6 * 1.07**2.5 / 2.5
    for n in (2, 4):
        body = Elasticity(1.0, 0.3, u_D=u, conditions=[Contact("y0")])
        found = solve(box(COMM, n, [-1, 0], [1, 1]), body).quantity(Integral(parts="y0"))
        assert around(found, known, 0.05)
        assert found.reason == "u_D not in the discrete spaces"
        widths.append(found.width)
    assert widths[1] < widths[0] / 2**1.2


@pytest.mark.parallel([1, 2])
def test_of_jumps():
    """What a body slips on another one, and how far one is lifted off another one."""
    sides = [Neumann("right", [0, 0.005]), Neumann("left", [0, -0.005]), Dirichlet("bottom", 0)]
    touching = Contact("fault", friction=Tresca(0.005), side="upper")
    rubbed = Elasticity(1.0, 0.0, conditions=[touching, Dirichlet("top", [0.02, -0.04]), *sides])
    lifted = Elasticity(
        1.0,
        0.0,
        conditions=[
            Contact("fault", side="upper"),
            Dirichlet("top", [0, "0.04 + 0.01*x"]),
            Neumann(["left", "right"]),
            Dirichlet("bottom", 0),
        ],
    )
    domain = two_boxes(COMM, 2, 2)
    slip = solve(domain, rubbed).quantity(Mean(parts="fault", direction=[1, 0], weight="1 + x^2"))
    assert slip.guaranteed, slip.reason
    assert around(slip, 0.01, 1e-3)
    opened = solve(domain, lifted)
    assert around(opened.quantity(Integral(parts="fault")), -0.045, 1e-3)
    with pytest.raises(InputError, match="take 'fault'"):
        opened.quantity(Mean(parts="fault (other side)"))


def test_on_curved_foundations():
    """A ring between two curved foundations, which share its weight: the force on one of them, and where it is."""
    touching = [Contact("outer", gap="0.02*(1 + y)"), Contact("inner", gap="0.02*(1 - y)", friction=Tresca(0.1))]
    ring = solve(
        build_domain(COMM, "annulus", 0.6, mesh="unstructured"), Elasticity(1.0, 0.3, f=[0, -0.1], conditions=touching)
    )
    weight = 0.1 * COMM.allreduce(float(ring.spaces.cell_measures.sum()))
    outer, found = ring.quantity(Force("outer", [0, 1])), ring.resultants()
    assert found["outer"][1] + found["inner"][1] == pytest.approx(weight)
    assert outer.guaranteed
    assert outer.lower < found["outer"][1] < outer.upper
    assert 0 < outer.width < 0.2 * weight
    height = ring.quantity(Mean(parts="outer", direction=[0, 1]))
    assert height.guaranteed
    assert height.upper < 0


def test_under_tools():
    """A block that tools press and bend is exact, and so are its quantities, with the motions of tools."""
    a, b, c = -0.1, 0.06, -0.04
    tool = Contact("z1", force={"z": a}, moment={"x": c / 12, "y": -b / 12})
    sides = Neumann(["x0", "x1", "y0", "y1"])
    body = Elasticity(1.0, 0.0, conditions=[Dirichlet("z0", 0), sides, tool])
    solution = solve(box(COMM, 1, [-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]), body)
    kinds: list[tuple[Kind, float, float]] = [
        (Energy(), -(a**2 + (b**2 + c**2) / 12) / 2, 1e-8),
        (Integral(parts="z1", weight="x", direction=[0, 0, 1]), b / 12, 1e-2),
        (Moment("z0", [1, 0, 0]), -c / 12, 1e-8),
    ]
    for kind, known, width in kinds:
        found = solution.quantity(kind)
        assert found.guaranteed, found.reason
        assert around(found, known, width), (kind, found)
    held = Fluxes(solution, Force("z0", [0, 0, 1]))
    far = held.ends(2.0**43, held.size(), held.response())  # the stress stays, and is rounding beside the data
    assert far.lower <= -a <= far.upper


def test_on_loaded_and_guided_parts():
    """Parts with a pressure, and those that are fixed in the normal direction, have means, too."""
    conditions = [
        Pressure("top", 0.1),
        Contact("bottom"),
        Dirichlet("left", 0, components="x"),
        Neumann("right"),
    ]
    body = Elasticity(1.0, 0.25, plane="stress", conditions=conditions)
    block = solve(build_domain(COMM, "square", 1, mesh="structured"), body)
    for kind, known in (
        (Mean(parts="left", direction=[0, 1]), -0.05),
        (Mean(parts=["top", "right"]), (-0.1 + 0.025) / 2),
    ):
        found = block.quantity(kind)
        assert found.guaranteed, found.reason
        assert around(found, known, 1e-2), (kind, found)
