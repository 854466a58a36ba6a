"""Scene parameters from pictures."""

from .run import Progress as Progress
from .solve import Fit as Fit, fit as fit
