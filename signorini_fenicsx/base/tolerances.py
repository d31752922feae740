"""What counts as zero, from the linear solver up to what is called a solution: each leaves room for the one before.

    ROUNDING 1e-14  <  LINEAR 1e-12  <  TIE 1e-11  <  STEP 1e-10  <  KKT 1e-8

All are shares of a size that the problem has itself, so that no unit enters.
"""

ROUNDING = 1e-14
"""What sums of numbers of size 1 leave."""
LINEAR = 1e-12
"""Relative residual of an iterative linear solver, and what a direct one leaves. Newton and interior-point methods stop
here too. Making the flux conforming amplifies what is left by 1/h: KKT residuals are 10 to 1000 times larger."""
TIE = 1e-11
"""A value of p or σ·n below this is rounding and decides nothing: ten times LINEAR. A wrong sign of that size stays far
below KKT."""
STEP = 1e-10
"""Step of a projection iteration at which it stops: such a step is up to 100 times smaller than the error left."""
KKT = 1e-8
"""A result with a larger KKT residual is not a solution, and a run that ends with one has failed."""
