"""Scene parameters from pictures."""

from .solve import Fit as Fit, Progress as Progress, fit as fit
