"""Expressions: text is read once into a tree, which is evaluated in UFL, in NumPy with gradients, and in intervals.

Text → `read` → tree; `to_ufl`, `values`, `values_and_gradient` and `interval` evaluate it.
Each function of the language is one row of the table in `functions`.
"""

from signorini_fenicsx.expressions.evaluation import (
    decided,
    difference,
    interval,
    linear_terms,
    rational,
    values,
    values_and_gradient,
)
from signorini_fenicsx.expressions.reader import parse_expression, parse_number, read
from signorini_fenicsx.expressions.symbolic import to_ufl
from signorini_fenicsx.expressions.tree import TREES, Binary, Tree, depends_on, exactly, is_polynomial, substituted

__all__ = [
    "TREES",
    "Binary",
    "Tree",
    "decided",
    "depends_on",
    "difference",
    "exactly",
    "interval",
    "is_polynomial",
    "linear_terms",
    "parse_expression",
    "parse_number",
    "rational",
    "read",
    "substituted",
    "to_ufl",
    "values",
    "values_and_gradient",
]
