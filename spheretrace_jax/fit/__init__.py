"""Fits: scene parameters from pictures."""

from .fit import fit as fit
from .result import Fit as Fit
from .solver.driver import Progress as Progress
