"""Fits: error against time, step by step, of every solver, from the same start."""

import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from ...base.types import Picture
from ...fit import fit
from ...fit.fit import DEFAULT_FREE
from ...fit.model.parameters import ACCESSORS
from ...fit.model.products import PRODUCTS
from ...fit.solver.driver import Progress
from ...rendering.render import render
from ...scene.scene import Scene
from ..checks.condition import uncertainty_at
from .mitsuba import RECIPES, adam_fit, fitted, matt, mitsuba
from .settings import Settings
from .work_precision import Diagram, Point

# A number counts as determined if it is known so well from a picture with so much noise.
_NOISE, _KNOWN = 1e-3, 0.05

# More points than this do not show in a figure.
_MOST_POINTS = 60

# After so many steps all is compiled.
_COMPILED = 3

# What most runs reach before their solver is stopped is a matter of time, not of steps.
_MOST_STEPS = 100_000


def solvers(thorough: bool) -> dict[str, dict[str, Any]]:
    """What `fit` is told for each method; Optax's Adam only where Optax is installed.

    **Arguments:** `thorough`: all of them, which compile for long.
    """
    tolerance: dict[str, Any] = dict(rtol=1e-10, atol=1e-10)
    levenberg = optx.LevenbergMarquardt(**tolerance)
    found: dict[str, dict[str, Any]] = {
        "ours": {},
        "Optimistix LevenbergMarquardt": dict(solver=levenberg),
    }
    if thorough:
        found |= {
            "ours, lights first": dict(start="lights"),
            "Optimistix Dogleg": dict(solver=optx.Dogleg(**tolerance)),
            "Optimistix GaussNewton": dict(solver=optx.GaussNewton(**tolerance)),
            "Optimistix BFGS": dict(solver=optx.BFGS(**tolerance)),
            "Optimistix NonlinearCG": dict(solver=optx.NonlinearCG(**tolerance)),
            "ours, whole Jacobian": dict(jacobian="dense"),
            "Optimistix LevenbergMarquardt, whole Jacobian": dict(
                jacobian="dense", solver=levenberg
            ),
        }
    if thorough and find_spec("optax"):
        import optax

        found["Optax Adam"] = dict(solver=optx.OptaxMinimiser(optax.adam(0.01), **tolerance))
    return found


def fits(scene: Scene, settings: Settings) -> Iterator[Diagram]:
    """The diagrams of fits to the scene's own picture; none without spheres or lights."""
    if len(scene.spheres) and len(scene.lights):
        yield _solver_fits(scene, settings)
        yield from matt_fits(scene, settings)


def _solver_fits(scene: Scene, settings: Settings) -> Diagram:
    """Fits of colours, ka, kd, ks and lights by each solver."""
    truth = scene.astype(jnp.float64).with_antialias(0)
    drawn: dict[str, Any] = dict(highlight=settings.highlight, bounces=settings.bounces)
    target = render(truth, width=settings.fit_size, height=settings.fit_size, **drawn)
    settings.say("fit: what the picture determines")
    known = uncertainty_at(truth, target, DEFAULT_FREE, _NOISE, **drawn).of(_products) < _KNOWN
    start, far = displaced(truth), np.linalg.norm(truth.lights.position, axis=-1, keepdims=True)

    products = jax.jit(_products)

    def error(found: Scene) -> float:
        off = np.abs(products(found) - products(truth))[known]
        away = np.abs(found.lights.position - truth.lights.position) / np.where(far > 0, far, 1)
        return float(max(off.max(initial=0), away.max()))

    ways = {
        method: partial(_curve, start, target, **drawn, **chosen)
        for method, chosen in solvers(settings.thorough).items()
    }
    points = _points("fit", ways, error, settings)
    return Diagram(
        "fit",
        f"Fits from the same start, {settings.fit_size} x {settings.fit_size}, step by step",
        "largest error of what the picture determines",
        "the scene itself: ka color, kd color and ks, absolute, and lights by their distance from "
        "the origin, as far as a picture determines them",
        float("nan"),
        points,
    )


def matt_fits(scene: Scene, settings: Settings) -> Iterator[Diagram]:
    """The diagram of fits of colours and a light beside Mitsuba with Adam, where that is installed.

    All spheres are matt, and each program fits its own picture, which it can reach exactly.
    """
    try:
        mitsuba()
    except ImportError:
        return
    truth = matt(scene.astype(jnp.float64))
    size, free = settings.fit_size, ("color", "light_position")
    target = render(truth, width=size, height=size, bounces=0)
    settings.say("fit: ours, matt spheres")
    known = uncertainty_at(truth, target, free, _NOISE, highlight=settings.highlight, bounces=0)
    seen = known.of(PRODUCTS["kd*color"]) < _KNOWN
    places = lambda s: [ACCESSORS[name](s) for name in free]
    start = eqx.tree_at(places, truth, places(displaced(truth)))
    ours = lambda most: [
        (seconds, fitted(found))
        for seconds, found in _curve(start, target, most, free=free, bounces=0)
    ]
    ways = {"ours": ours} | {
        name: partial(adam_fit, start, truth, size, recipe) for name, recipe in RECIPES.items()
    }
    true = fitted(truth)
    away = np.linalg.norm(true[0])

    def error(values: np.ndarray) -> float:
        off = values - true
        return float(max(np.linalg.norm(off[0]) / away, np.abs(off[1:][seen]).max(initial=0)))

    points = _points("fit_matt", ways, error, settings)
    yield Diagram(
        "fit_matt",
        f"Fits of matt spheres and a light, {size} x {size}, step by step",
        "largest error of what the picture determines",
        "the scene itself: kd color, absolute, and the light by its distance from the origin; "
        "Mitsuba computes in float32",
        float("nan"),
        points,
    )


def displaced(truth: Scene) -> Scene:
    """All that is fitted is wrong: coefficients by a tenth, lights by 6 degrees and a fifth."""
    turn = jnp.asarray([[0.995, -0.1, 0], [0.1, 0.995, 0], [0, 0, 1]], truth.dtype)
    places = lambda s: [ACCESSORS[name](s) for name in DEFAULT_FREE]
    *coefficients, lights = places(truth)
    return eqx.tree_at(places, truth, [*(0.9 * x for x in coefficients), lights @ turn * 1.2])


def _points(
    diagram: str, ways: dict[str, Callable], error: Callable[[Any], float], settings: Settings
) -> tuple[Point, ...]:
    """Each way's points. **Arguments:** `ways`: from the most seconds to `_curve`s."""
    points = []
    for method, way in ways.items():
        settings.say(f"{method}, {diagram}")
        first, curve = way(settings.fit_seconds / 10), way(settings.fit_seconds)
        k = min(_COMPILED, len(first) - 1, len(curve) - 1)
        compiling = max(first[k][0] - curve[k][0], 0.0)
        for k in _spread(len(curve)):
            seconds, found = curve[k]
            one = f"step {k}", float(k), "float64", seconds, compiling, error(found), 0
            points.append(Point(diagram, method, *one))
    return tuple(points)


def _curve(first: Scene, target: Picture, most: float, **chosen: Any) -> list:
    """Seconds and scenes, step by step from the first one on, until it is time to stop."""
    curve, began = [(0.0, first)], time.perf_counter()

    def note(progress: Progress) -> None:
        curve.append((time.perf_counter() - began, progress.scene))
        if curve[-1][0] > most:
            raise KeyboardInterrupt  # as fit ends with the best scene so far

    with jax.numpy_dtype_promotion("standard"):  # as Optax needs it
        fit(first, target, callback=note, max_steps=_MOST_STEPS, **chosen)
    return curve


def _products(scene: Scene) -> Float[Array, " numbers"]:
    """ka color, kd color and ks of all spheres."""
    return jnp.concatenate([product(scene).reshape(-1) for product in PRODUCTS.values()])


def _spread(count: int) -> list[int]:
    """Up to so many numbers of steps, ever wider apart."""
    wanted = (
        np.geomspace(1, count, _MOST_POINTS) if count > _MOST_POINTS else np.arange(1, count + 1)
    )
    return sorted({int(k) - 1 for k in wanted})
