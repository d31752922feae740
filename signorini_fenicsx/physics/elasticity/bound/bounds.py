"""What bounds the errors of elastic bodies."""

from signorini_fenicsx.certificate.certify import Bounds
from signorini_fenicsx.physics.elasticity.bound.certify import certificate_of
from signorini_fenicsx.physics.elasticity.bound.of_field import field_bound
from signorini_fenicsx.physics.elasticity.bound.steps import StepBounds

BOUNDS = Bounds(certificate_of, field_bound, StepBounds)
