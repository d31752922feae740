"""What bounds the errors of scalar problems."""

from signorini_fenicsx.certificate.certify import Bounds
from signorini_fenicsx.physics.diffusion.bound.certify import certificate_of
from signorini_fenicsx.physics.diffusion.bound.of_field import field_bound
from signorini_fenicsx.physics.diffusion.bound.steps import StepBounds

BOUNDS = Bounds(certificate_of, field_bound, StepBounds)
