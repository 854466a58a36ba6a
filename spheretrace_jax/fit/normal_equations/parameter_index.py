"""The index of a fit's free parameters in one vector of numbers: name by name, row by row."""

import math

import numpy as np
from jaxtyping import Int

from ...scene.scene import Scene
from ..model.accessors import CAMERA, LIGHTS, SPHERES, value

Places = Int[np.ndarray, "..."]


class ParameterIndex:
    """The places of each free parameter's numbers in the vector of all."""

    size: int  #: how many numbers there are
    places: dict[str, Places]  #: by name, in the shape of the parameter
    spheres: dict[str, Places]  #: those of the spheres, of the lights and of the camera
    lights: dict[str, Places]
    camera: dict[str, Places]
    exposure: Places | None
    each: Int[np.ndarray, "labels columns"]  #: of each object, what moves pixels that show it alone
    all: Int[np.ndarray, " columns"]  #: of everything, what moves pixels that show several objects

    def __init__(self, scene: Scene, free: tuple[str, ...]):
        shapes = [(3,) if name == "exposure" else value(scene, name).shape for name in free]
        ends = np.cumsum([math.prod(s) for s in shapes])
        pieces = np.split(np.arange(ends[-1]), ends[:-1])
        places = {n: p.reshape(s) for n, p, s in zip(free, pieces, shapes, strict=True)}
        among = lambda names: {n: p for n, p in places.items() if n in names}
        self.size = int(ends[-1])
        self.places = places
        self.spheres, self.lights, self.camera = (among(x) for x in (SPHERES, LIGHTS, CAMERA))
        self.exposure = places.get("exposure")

        exposure = [] if self.exposure is None else [self.exposure]
        others = (*self.lights.values(), *self.camera.values(), *exposure)
        others = np.concatenate([np.zeros(0, int), *(p.reshape(-1) for p in others)])
        n, objects = len(scene.spheres), scene.objects
        rows = [p.reshape(n, -1) for p in self.spheres.values()]
        width = sum(p.shape[1] for p in rows)
        # the last row is the sky's; what is no sphere has no parameters: out of bounds
        self.each = np.full((objects + 1, width + others.size), self.size)
        self.each[:n, :width] = np.concatenate([np.zeros((n, 0), int), *rows], axis=1)
        self.each[:, width:] = others
        self.all = np.concatenate([*(p.reshape(-1) for p in self.spheres.values()), others])
