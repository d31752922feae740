"""Derivatives of solutions by their data, through contact.

`Solution.gradient` and `Solution.derivative` give them; here are what these return, their warning, and the gradient of
all steps in time.
"""

from signorini_fenicsx.derivatives.gradient import Change, Gradient, NotDifferentiable, gradient_in_time

__all__ = ["Change", "Gradient", "NotDifferentiable", "gradient_in_time"]
