"""Fits: scene parameters from pictures."""

from .fit import Fit as Fit, fit as fit
from .solver.driver import Progress as Progress
