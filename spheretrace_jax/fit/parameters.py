"""The free parameters of a fit: which they are, how they are scaled and bounded.

A solver works on dimensionless numbers of order one, a dict `name -> array`. Bounds are respected
twice: `bounds` tells solvers that know boxes, and for all others numbers outside 0..1 are folded
back like a sheet of paper, so that any number stands for a valid scene. Folding is the identity
inside the bounds and has slope +-1 everywhere: where the truth lies on a bound (colour 0, ks 0)
Levenberg-Marquardt still converges quadratically, in 7 steps on the nine spheres, where sigmoid
and sine, whose slope vanishes there, had not arrived after 60.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..errors import InputError
from ..scene import Scene

Values = dict[str, Float[Array, "..."]]

#: name: (where in the scene, kind). "unit" is 0..1, "positive" is fitted by its logarithm.
_PARAMETERS = {
    "color": (lambda s: s.spheres.color, "unit"),
    "ka": (lambda s: s.spheres.ka, "unit"),
    "kd": (lambda s: s.spheres.kd, "unit"),
    "ks": (lambda s: s.spheres.ks, "unit"),
    "exponent": (lambda s: s.spheres.exponent, "positive"),
    "kgr": (lambda s: s.spheres.kgr, "unit"),
    "kt": (lambda s: s.spheres.kt, "unit"),
    "light_color": (lambda s: s.lights.color, "nonnegative"),
    "light_position": (lambda s: s.lights.position, "any"),
    "center": (lambda s: s.spheres.center, "any"),
    "radius": (lambda s: s.spheres.radius, "positive"),
    "theta": (lambda s: s.camera.theta, "any"),
    "phi": (lambda s: s.camera.phi, "any"),
    "mu": (lambda s: s.camera.mu, "positive"),
    "distance": (lambda s: s.camera.distance, "positive"),
}

NAMES = tuple(_PARAMETERS)

#: Those whose change is seen only by where edges are.
GEOMETRY = frozenset(("center", "radius", "theta", "phi", "mu", "distance"))

# An exponent of 0 has no logarithm; a fit starts from this instead.
_LEAST_EXPONENT = 1e-2


def check_free(free: tuple[str, ...]) -> None:
    """**Raises:** `InputError` for names that cannot be free, or none at all."""
    unknown = [name for name in free if name not in _PARAMETERS]
    if unknown or not free:
        got = ", ".join(unknown) or "none"
        raise InputError(f"free parameters must be among {', '.join(NAMES)}, got {got}")
    if len(set(free)) < len(free):
        raise InputError(f"each free parameter must be named once, got {', '.join(free)}")


def check_present(scene: Scene, free: tuple[str, ...]) -> None:
    """**Raises:** `InputError` for free parameters of things that the scene does not have."""
    for name in free:
        if value(scene, name).size == 0:
            things = "lights" if name.startswith("light") else "spheres"
            raise InputError(f"{name} is free, but the scene has no {things}")
        if name in ("radius", "mu", "distance") and not (value(scene, name) > 0).all():
            raise InputError(f"{name} is free: it must start above 0")


def value(scene: Scene, name: str) -> Array:
    """The array of a scene that a free parameter's name stands for."""
    return _PARAMETERS[name][0](scene)


def length_scales(scene: Scene) -> Values:
    """Lengths that make lengths numbers of order one, so that a fit is blind to the user's units.

    For the lights' positions how far they are: the long valley of a light's distance takes 7 steps
    instead of 27. For each sphere's centre its radius, and for all else the start itself.
    """
    spheres, camera = scene.spheres, scene.camera
    n = len(spheres)
    middle = jnp.mean(spheres.center, axis=0) if n else jnp.zeros(3, scene.dtype)
    away = jnp.linalg.norm(scene.lights.position - middle[None], axis=1)
    lengths = {
        "light_position": jnp.max(jnp.append(away, camera.mu)),
        "center": jnp.broadcast_to(spheres.radius[:, None], (n, 3)),
        "radius": spheres.radius,
        "mu": camera.mu,
        "distance": camera.distance,
    }
    return {name: jnp.where(length > 0, length, 1) for name, length in lengths.items()}


def to_solver(scene: Scene, free: tuple[str, ...], scales: Values) -> Values:
    """The numbers that a solver starts from: those of the scene, brought within the bounds."""

    def one(name: str) -> Array:
        start, kind = value(scene, name), _PARAMETERS[name][1]
        if name == "exponent":
            start = jnp.maximum(start, _LEAST_EXPONENT)
        start = start / scales.get(name, 1)
        if kind == "positive":
            return jnp.log(start)
        if kind == "any":
            return start
        return jnp.clip(start, 0, 1 if kind == "unit" else None)

    return {name: one(name) for name in free}


def to_scene(scene: Scene, values: Values, scales: Values) -> Scene:
    """The scene that a solver's numbers stand for; what is not free stays as in `scene`."""

    def one(name: str) -> Array:
        y, kind = values[name], _PARAMETERS[name][1]
        if kind == "unit":
            return _fold(y)
        if kind == "nonnegative":
            return jnp.abs(y)
        return (jnp.exp(y) if kind == "positive" else y) * scales.get(name, 1)

    places = [_PARAMETERS[name][0] for name in values]
    new = [one(name) for name in values]
    return eqx.tree_at(lambda s: [where(s) for where in places], scene, new)


def bounds(values: Values) -> tuple[Values, Values]:
    """The least and greatest allowed of the solver's numbers."""

    def limit(name: str, low: bool) -> Array:
        kind = _PARAMETERS[name][1]
        if low:
            value = 0.0 if kind in ("unit", "nonnegative") else -jnp.inf
        else:
            value = 1.0 if kind == "unit" else jnp.inf
        return jnp.full_like(values[name], value)

    return {n: limit(n, True) for n in values}, {n: limit(n, False) for n in values}


def _fold(y: Array) -> Array:
    """y for y in 0..1; mirrored at 0 and 1 beyond."""
    y = jnp.abs(y)
    turn = jax.lax.stop_gradient(jnp.floor(y))
    return jnp.where(turn % 2 == 0, y - turn, 1 - (y - turn))


def hold_ka(fitted: Scene, start: Scene, free: tuple[str, ...]) -> Scene:
    """Fixes what no picture determines: color times c, with ka and kd divided by c, looks the same.

    Of these equal scenes the one is taken whose ka is the start's, or, where color or kd would
    leave 0..1 then, the nearest to it. Only where color, ka and kd are all free.
    """
    if not {"color", "ka", "kd"} <= set(free):
        return fitted
    s, wanted = fitted.spheres, start.spheres.ka
    some = (s.ka > 0) & (wanted > 0)
    c = jnp.where(some, s.ka / jnp.where(some, wanted, 1), 1)
    brightest = jnp.max(s.color, axis=1)
    most = jnp.where(brightest > 0, 1 / jnp.where(brightest > 0, brightest, 1), 1)
    c = jnp.clip(c, jnp.maximum(s.kd, s.ka), most)
    c = jnp.where(c > 0, c, 1)
    within = lambda x: jnp.clip(x, 0, 1)  # against the last bit of rounding
    return eqx.tree_at(
        lambda f: (f.spheres.color, f.spheres.ka, f.spheres.kd),
        fitted,
        (within(s.color * c[:, None]), within(s.ka / c), within(s.kd / c)),
    )
