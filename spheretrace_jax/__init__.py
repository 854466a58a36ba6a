"""A differentiable ray caster for worlds of spheres, on JAX."""

from .needs import Needs as Needs, needs as needs
from .render import render as render
from .scene import (
    BackPlane as BackPlane,
    Camera as Camera,
    Lights as Lights,
    Planes as Planes,
    Scene as Scene,
    Spheres as Spheres,
    Texture as Texture,
)

__version__ = "0.1.0"
