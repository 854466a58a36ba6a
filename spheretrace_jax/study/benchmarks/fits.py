"""Fits: error against time of every solver, step by step from the same start."""

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
from ...fit.model.accessors import ACCESSORS, default_free
from ...fit.model.products import PRODUCTS
from ...fit.solver.driver import Progress
from ...rendering.render import render
from ...scene.scene import Scene
from ..checks.condition import uncertainty_at
from .mitsuba import RECIPES, adam_fit, fitted, matt, mitsuba
from .settings import Settings
from .work_precision import Diagram, Point

# Largest standard deviation of a number that counts as determined, and the noise of the picture,
# also a standard deviation, which causes the deviation.
_LARGEST_DEVIATION, _NOISE = 0.05, 1e-3

# Limit of the points of a curve: more do not show in a figure.
_MOST_POINTS = 60

# Number of steps in which a fit compiles all programs.
_COMPILING_STEPS = 3

# Limit of the steps of a fit, so large that time stops the fit before.
_MOST_STEPS = 100_000


def solvers(thorough: bool) -> dict[str, dict[str, Any]]:
    """Lists the methods, with their arguments of `fit`; Optax's Adam only if installed.

    **Arguments:** `thorough`: True for all methods, which compile for long.
    """
    tolerance: dict[str, Any] = dict(rtol=1e-10, atol=1e-10)
    levenberg = optx.LevenbergMarquardt(**tolerance)
    methods: dict[str, dict[str, Any]] = {
        "ours": {},
        "Optimistix LevenbergMarquardt": dict(solver=levenberg),
    }
    if thorough:
        methods |= {
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

        methods["Optax Adam"] = dict(solver=optx.OptaxMinimiser(optax.adam(0.01), **tolerance))
    return methods


def fits(scene: Scene, settings: Settings) -> Iterator[Diagram]:
    """Yields the diagrams of fits to a scene's own picture; none without spheres or lights."""
    if len(scene.spheres) and len(scene.lights):
        yield _solver_fits(scene, settings)
        yield from matt_fits(scene, settings)


def _solver_fits(scene: Scene, settings: Settings) -> Diagram:
    """Returns the diagram of fits of colours, ka, kd, ks and lights, by each solver."""
    truth = scene.astype(jnp.float64).with_antialias(0)
    drawn: dict[str, Any] = dict(highlight=settings.highlight, bounces=settings.bounces)
    target = render(truth, width=settings.fit_size, height=settings.fit_size, **drawn)
    settings.say("fit: what the picture determines")
    uncertainty = uncertainty_at(truth, target, default_free(truth), _NOISE, **drawn)
    determined = uncertainty.of(_products) < _LARGEST_DEVIATION
    start = displaced(truth)
    distance = np.linalg.norm(truth.lights.position, axis=-1, keepdims=True)
    products = jax.jit(_products)

    def error(fitted: Scene) -> float:
        of_products = np.abs(products(fitted) - products(truth))[determined]
        shift = np.abs(fitted.lights.position - truth.lights.position)
        return float(
            max(of_products.max(initial=0), (shift / np.where(distance > 0, distance, 1)).max())
        )

    methods = {
        method: partial(_curve, start, target, **drawn, **arguments)
        for method, arguments in solvers(settings.thorough).items()
    }
    points = _points("fit", methods, error, settings)
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
    """Yields the diagram of fits of colours and a light, also by Mitsuba with Adam if installed.

    All spheres are matt. Each program fits its own picture, which it can match exactly. Mitsuba's
    fit moves a light at a point, without our fall-off.
    """
    if scene.lights.directional[0] or scene.lights.falloff[0]:
        return
    try:
        mitsuba()
    except ImportError:
        return
    truth = matt(scene.astype(jnp.float64))
    size, free = settings.fit_size, ("color", "light_position")
    target = render(truth, width=size, height=size, bounces=0)
    settings.say("fit: ours, matt spheres")
    uncertainty = uncertainty_at(
        truth, target, free, _NOISE, highlight=settings.highlight, bounces=0
    )
    determined = uncertainty.of(PRODUCTS["kd*color"]) < _LARGEST_DEVIATION
    values = lambda s: [ACCESSORS[name](s) for name in free]
    start = eqx.tree_at(values, truth, values(displaced(truth)))
    ours = lambda most: [
        (seconds, fitted(step))
        for seconds, step in _curve(start, target, most, free=free, bounces=0)
    ]
    methods = {"ours": ours} | {
        name: partial(adam_fit, start, truth, size, recipe) for name, recipe in RECIPES.items()
    }
    true = fitted(truth)
    distance = np.linalg.norm(true[0])

    def error(values: np.ndarray) -> float:
        light, colors = np.split(np.abs(values - true), [1])
        return float(max(np.linalg.norm(light[0]) / distance, colors[determined].max(initial=0)))

    points = _points("fit_matt", methods, error, settings)
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
    """Displaces all fitted parameters: coefficients by a tenth, lights by 6 degrees and a fifth."""
    turn = jnp.asarray([[0.995, -0.1, 0], [0.1, 0.995, 0], [0, 0, 1]], truth.dtype)
    values = lambda s: [ACCESSORS[name](s) for name in DEFAULT_FREE]
    *coefficients, lights = values(truth)
    return eqx.tree_at(values, truth, [*(0.9 * x for x in coefficients), lights @ turn * 1.2])


def _points(
    diagram: str, methods: dict[str, Callable], error: Callable[[Any], float], settings: Settings
) -> tuple[Point, ...]:
    """Returns the points of all methods.

    **Arguments:** `methods`: functions from a time limit in seconds to a curve, as `_curve`.
    `error`: of a scene of a curve.
    """
    points = []
    for method, fit_for in methods.items():
        settings.say(f"{method}, {diagram}")
        first, curve = fit_for(settings.fit_seconds / 10), fit_for(settings.fit_seconds)
        k = min(_COMPILING_STEPS, len(first) - 1, len(curve) - 1)
        compiling = max(first[k][0] - curve[k][0], 0.0)
        for k in _spread(len(curve)):
            seconds, values = curve[k]
            one = f"step {k}", float(k), "float64", seconds, compiling, error(values), 0
            points.append(Point(diagram, method, *one))
    return tuple(points)


def _curve(first: Scene, target: Picture, most: float, **chosen: Any) -> list:
    """Fits until `most` seconds have passed. **Returns:** seconds and scenes, step by step."""
    curve, began = [(0.0, first)], time.perf_counter()

    def note(progress: Progress) -> None:
        curve.append((time.perf_counter() - began, progress.scene))
        if curve[-1][0] > most:
            raise KeyboardInterrupt  # which ends `fit` with the best scene so far

    with jax.numpy_dtype_promotion("standard"):  # as Optax needs it
        fit(first, target, callback=note, max_steps=_MOST_STEPS, **chosen)
    return curve


def _products(scene: Scene) -> Float[Array, " numbers"]:
    """Returns ka color, kd color and ks of all spheres."""
    return jnp.concatenate([product(scene).reshape(-1) for product in PRODUCTS.values()])


def _spread(count: int) -> list[int]:
    """Returns at most `_MOST_POINTS` numbers of steps, at growing distances."""
    wanted = (
        np.geomspace(1, count, _MOST_POINTS) if count > _MOST_POINTS else np.arange(1, count + 1)
    )
    return sorted({int(k) - 1 for k in wanted})
