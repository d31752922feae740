"""The algebra of jets.

A *jet* is the value of a function and, where it is wanted, its gradient: an array whose last axis has 1 or 1 + dim
entries. Jets are added as arrays are.
"""

import numpy as np

from signorini_fenicsx.base.arrays import Array


def product(a: Array, b: Array) -> Array:
    """The jet of a product of two functions, from theirs."""
    jet = a[..., :1] * b + b[..., :1] * a
    jet[..., :1] = a[..., :1] * b[..., :1]
    return jet


def cut_off(cut: Array, jet: Array) -> Array:
    """The jet of χ times a function; 0 where χ is 0, whatever the function is there."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.where(cut[..., :1] > 0, product(cut, jet), 0.0)


def larger(a: Array, b: Array) -> Array:
    """The jet of the larger of two functions."""
    return np.where(a[..., :1] >= b[..., :1], a, b)
