"""What bounds the errors of elastic bodies.

*The certificates of the steps of an elastic body in time*.

The bound of a step is that of the distance to the exact solution after the computed slip of the last step. This slip
jumps from facet to facet. With a continuous one, the v of the last certificate with cubics that give it the right
means, bounds of bodies that stick were larger by 3 to 35 %.
"""

from signorini_fenicsx.certificate.certify import Bounds
from signorini_fenicsx.physics.elasticity.bound.certify import certificate_of
from signorini_fenicsx.physics.elasticity.bound.of_field import field_bound

BOUNDS = Bounds(certificate_of, field_bound)
