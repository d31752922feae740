"""How solutions of viscous flow are kept in files: as those of bodies."""

from dataclasses import replace
from functools import partial

from signorini_fenicsx.physics.elasticity.kept import KEEPING as OF_BODIES
from signorini_fenicsx.physics.elasticity.kept import read
from signorini_fenicsx.physics.stokes.problem import Leak, Outflow, StokesBoundary, StokesProblem
from signorini_fenicsx.physics.stokes.solution import StokesSolution

KEEPING = replace(
    OF_BODIES,
    boundary=StokesBoundary,
    problem=StokesProblem,
    laws={**OF_BODIES.laws, Outflow.word: Outflow, Leak.word: Leak},
    read=partial(read, kind=StokesSolution),
)
