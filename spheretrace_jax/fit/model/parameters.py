"""The free parameters of a fit: which they are, how they are scaled and bounded.

A solver works on dimensionless numbers of order one, a dict `name -> array`. Bounds are respected
twice: `bounds` tells solvers that know boxes, and for all others numbers outside 0..1 are folded
back like a sheet of paper, so that any number stands for a valid scene. Folding is the identity
inside the bounds and has slope +-1 everywhere: where the truth lies on a bound (colour 0, ks 0)
Levenberg-Marquardt still converges quadratically, in 7 steps on the nine spheres, where sigmoid
and sine, whose slope vanishes there, had not arrived after 60.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.errors import InputError
from ...scene.scene import Scene
from ...xla.jit import compiled
from .light_position import LightPosition, light_position_at

Values = dict[str, Float[Array, "..."]]

#: Where in the scene the parameters of spheres, lights and the camera are.
SPHERES: dict[str, Callable] = {
    "color": lambda s: s.spheres.color,
    "ka": lambda s: s.spheres.ka,
    "kd": lambda s: s.spheres.kd,
    "ks": lambda s: s.spheres.ks,
    "exponent": lambda s: s.spheres.exponent,
    "kgr": lambda s: s.spheres.kgr,
    "kt": lambda s: s.spheres.kt,
    "center": lambda s: s.spheres.center,
    "radius": lambda s: s.spheres.radius,
}
LIGHTS: dict[str, Callable] = {
    "light_position": lambda s: s.lights.position,
    "light_color": lambda s: s.lights.color,
}
CAMERA: dict[str, Callable] = {
    "theta": lambda s: s.camera.theta,
    "phi": lambda s: s.camera.phi,
    "mu": lambda s: s.camera.mu,
    "distance": lambda s: s.camera.distance,
}
PLACES = SPHERES | LIGHTS | CAMERA

#: What may be free. The exposure is a picture's, not the scene's.
NAMES = (*PLACES, "exposure")

#: Those whose change is seen only by where edges are.
GEOMETRY = frozenset(("center", "radius", *CAMERA))

# Numbers in 0..1; numbers that are fitted by their logarithm.
_UNIT = frozenset(("color", "ka", "kd", "ks", "kgr", "kt"))
_POSITIVE = frozenset(("exponent", "radius", "mu", "distance", "exposure"))

# An exponent of 0 has no logarithm; a fit starts from this instead.
_LEAST_EXPONENT = 1e-2


def check_free(free: tuple[str, ...]) -> None:
    """**Raises:** `InputError` for names that cannot be free, or none at all."""
    unknown = [name for name in free if name not in NAMES]
    if unknown or not free:
        got = ", ".join(unknown) or "none"
        raise InputError(f"free parameters must be among {', '.join(NAMES)}, got {got}")
    if len(set(free)) < len(free):
        raise InputError(f"each free parameter must be named once, got {', '.join(free)}")


def check_present(scene: Scene, free: tuple[str, ...]) -> None:
    """**Raises:** `InputError` for free parameters of things that the scene does not have."""
    for name in free:
        if name == "exposure":
            continue
        if value(scene, name).size == 0:
            things = "lights" if name in LIGHTS else "spheres"
            raise InputError(f"{name} is free, but the scene has no {things}")
        if name in ("radius", "mu", "distance") and not (value(scene, name) > 0).all():
            raise InputError(f"{name} is free: it must start above 0")


def value(scene: Scene, name: str) -> Array:
    """The array of a scene that a free parameter's name stands for."""
    return PLACES[name](scene)


class Parameters(eqx.Module):
    """The way from a solver's numbers to a scene, and back at the start."""

    scene: Scene  #: the start; what is not free stays as it is here
    charts: LightPosition | None  #: of the lights' positions
    free: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, scene: Scene, free: tuple[str, ...]):
        self.scene, self.free = scene, free
        self.charts = None
        if "light_position" in free:
            self.charts = _charts(scene)

    def start(self) -> Values:
        """The solver's numbers at the start, brought within the bounds."""
        return {name: self._start(name) for name in self.free}

    def _start(self, name: str) -> Array:
        if name == "exposure":
            return jnp.zeros(3, self.scene.dtype)
        if name == "light_position":
            return jnp.zeros_like(self.scene.lights.position)
        start = value(self.scene, name) / self._unit(name)
        if name == "exponent":
            start = jnp.maximum(start, _LEAST_EXPONENT)
        if name in _POSITIVE:
            return jnp.log(start)
        if name in _UNIT:
            return jnp.clip(start, 0, 1)
        return jnp.maximum(start, 0) if name == "light_color" else start

    def _unit(self, name: str) -> Array | int:
        """What makes a length a number of order one: a fit is blind to the user's units."""
        if name in ("radius", "mu", "distance"):
            return value(self.scene, name)
        if name == "center":
            radius = self.scene.spheres.radius
            return jnp.where(radius > 0, radius, 1)[:, None]
        return 1

    def natural(self, values: Values) -> Values:
        """The parameters themselves, in the scene's units, that a solver's numbers stand for."""
        return {name: self._natural(name, y) for name, y in values.items()}

    def _natural(self, name: str, y: Array) -> Array:
        if name == "light_position" and self.charts is not None:
            return jax.vmap(LightPosition.position)(self.charts, y)
        if name in _UNIT:
            return _fold(y)
        if name == "light_color":
            return jnp.abs(y)
        return (jnp.exp(y) if name in _POSITIVE else y) * self._unit(name)

    def place(self, values: Values) -> tuple[Scene, Float[Array, " 3"]]:
        """The scene that a solver's numbers stand for, and the exposure."""
        natural = self.natural(values)
        exposure = natural.pop("exposure", jnp.ones(3, self.scene.dtype))
        if not natural:
            return self.scene, exposure
        where = lambda scene: [PLACES[name](scene) for name in natural]
        return eqx.tree_at(where, self.scene, list(natural.values())), exposure

    def bounds(self) -> tuple[Values, Values]:
        """The least and greatest allowed of the solver's numbers."""

        def limit(name: str, y: Array, low: bool) -> Array:
            if name == "light_position" and self.charts is not None and low:
                return jax.vmap(LightPosition.least)(self.charts)
            if low:
                bound = 0.0 if name in _UNIT or name == "light_color" else -jnp.inf
            else:
                bound = 1.0 if name in _UNIT else jnp.inf
            return jnp.full_like(y, bound)

        start = self.start()
        least, most = ({n: limit(n, y, low) for n, y in start.items()} for low in (True, False))
        return least, most


@compiled
def _charts(scene: Scene) -> LightPosition:
    middle, size = extent(scene)
    return jax.vmap(light_position_at, (0, None, None))(scene.lights.position, middle, size)


def extent(scene: Scene) -> tuple[Float[Array, " 3"], Float[Array, ""]]:
    """The middle of a scene's spheres, and how far they reach around it."""
    spheres = scene.spheres
    if not len(spheres):
        return jnp.zeros(3, scene.dtype), jnp.where(scene.camera.mu > 0, scene.camera.mu, 1)
    middle = jnp.mean(spheres.center, axis=0)
    reach = jnp.linalg.norm(spheres.center - middle[None], axis=1) + spheres.radius
    size = jnp.max(reach)
    return middle, jnp.where(size > 0, size, 1)


def _fold(y: Array) -> Array:
    """y for y in 0..1, with a slope of 1 at 0 and 1, too; mirrored at 0 and 1 beyond."""
    y = jnp.abs(y)
    turn = jax.lax.stop_gradient(jnp.maximum(jnp.ceil(y) - 1, 0))
    return jnp.where(turn % 2 == 0, y - turn, 1 - (y - turn))
