"""A third physics, a bed of springs: k u = f in each cell, but u ≥ 0 in the cells behind Γ.

In time springs settle: each step adds f at its time to what bears on them.
"""

from signorini_fenicsx.solving.physics import Physics

SPRINGS = Physics(
    problem="springs.solving:Bed",
    system="springs.solving:System",
    keeping="springs.kept:KEEPING",
    case="springs.case:BedCase",
    quantities="springs.quantities:QUANTITIES",
    pictures="springs.pictures:PICTURES",
)
"""A bed of springs; there is no bound of its errors, and no proof."""
