"""Tolerances, from rounding to the residual of a solution. Each is larger than the errors that the one before allows.

    ROUNDING 1e-14  <  LINEAR 1e-12  <  TIE 1e-11  <  STEP 1e-10  <  KKT 1e-8

All are relative to sizes of the problem itself, so they do not depend on units.
"""

ROUNDING = 1e-14
"""Rounding of sums of numbers of size 1."""
LINEAR = 1e-12
"""Relative residual at which an iterative linear solver stops; a direct solver reaches about the same. Newton and
interior-point methods stop here too. Making the flux conforming multiplies this error by 1/h, so KKT residuals are 10
to 1000 times larger."""
TIE = 1e-11
"""Values of p and σ·n below this are rounding and decide nothing. It is ten times LINEAR; a wrong sign of this size is
still far below KKT."""
STEP = 1e-10
"""A projection iteration stops at a step of this size. The error that remains may be up to 100 times larger."""
KKT = 1e-8
"""A result with a larger KKT residual is not a solution, and the run has failed."""
EXACT_CONTACT = 1e-12
"""An exact gap of less than this, relative to the largest |u| on Γ_S, is contact."""
