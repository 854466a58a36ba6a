"""Computations of `test_sharding.py`: on one device, on several, on those of several processes."""

from collections.abc import Callable
from typing import Any

import conftest  # noqa: F401 (sets the precision)
import equinox as eqx
import helpers.scenes as scenes
import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.multihost_utils import process_allgather
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array

import spheretrace_jax as st
from spheretrace_jax.base.vec import SplitVec, Vec
from spheretrace_jax.fit.problem.make_problem import make_problem
from spheretrace_jax.fit.problem.problem import normal_at
from spheretrace_jax.rendering.pixel_filter import filter_pixels
from spheretrace_jax.rendering.render import draw
from spheretrace_jax.scene.settings import RenderSettings, render_settings
from spheretrace_jax.xla.sharding import on_devices

Results = dict[str, np.ndarray]

WIDTH, HEIGHT, UNEVEN = 20, 16, 13
PROCESSES, DEVICES = 2, 8


def draw_picture(
    scene: st.Scene, height: int, sharding: NamedSharding | None, **settings
) -> np.ndarray:
    found = st.render(scene, width=WIDTH, height=height, sharding=sharding, **settings)
    if sharding is not None and height == HEIGHT:
        assert {shard.data.shape[0] for shard in found.addressable_shards} == {HEIGHT // DEVICES}
    return np.asarray(process_allgather(found, tiled=True))


def draw_layers(scene: st.Scene, sharding: NamedSharding | None) -> np.ndarray:
    found = st.render_layers(scene, width=WIDTH, height=UNEVEN, sharding=sharding)
    both = jnp.concatenate([found.normal, found.coverage[..., None]], axis=-1)
    return np.asarray(process_allgather(both, tiled=True))


def pictures(sharding: NamedSharding | None) -> Results:
    scene = scenes.three_spheres()
    return {
        "a height that devices divide": draw_picture(scene, HEIGHT, sharding),
        "another, 2 x 2 samples": draw_picture(scene, UNEVEN, sharding, samples=2),
        "layers": draw_layers(scene, sharding),
    }


def operations(sharding: NamedSharding | None) -> Results:
    """Returns an even share of operations and memory over that of one device: 1 if even."""
    scene = scenes.three_spheres()

    def used(sharding: NamedSharding | None) -> np.ndarray:
        size = 8 * DEVICES
        settings = render_settings(scene, size, size, sharding=sharding)
        compiled: Any = eqx.filter_jit(draw).lower(scene, settings).compile().compiled
        memory = compiled.memory_analysis().temp_size_in_bytes
        return np.array([compiled.cost_analysis()["flops"], memory])

    ratios = used(None) / used(sharding)
    return {"ratios": np.round(ratios if sharding is None else ratios / DEVICES, 1)}


def gradients(
    sharding: NamedSharding | None, scene: st.Scene | None = None, height: int = HEIGHT
) -> Results:
    """Returns the gradient of a weighted sum of a picture's numbers."""
    scene = scenes.three_spheres() if scene is None else scene
    needs = st.needs(scene)
    weight = np.random.default_rng(0).normal(size=(height, WIDTH, 3))
    draw_rows = lambda s: st.render(s, width=WIDTH, height=height, needs=needs, sharding=sharding)
    gradient = jax.jit(jax.grad(lambda s: jnp.sum(weight * draw_rows(s))))(scene)
    leaves = jax.tree_util.tree_leaves_with_path(gradient)
    return {jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in leaves}


def neighbours(sharding: NamedSharding | None) -> Results:
    """Filters smooth shading by the rows above and below, some of which other devices hold."""
    random = np.random.default_rng(0)
    height = UNEVEN if sharding is None else HEIGHT
    color, edge = random.normal(size=(3, HEIGHT, WIDTH)), random.uniform(size=(HEIGHT, WIDTH)) < 0.1
    scene = scenes.three_spheres(antialias=1)
    settings = render_settings(scene, WIDTH, UNEVEN, sharding=sharding)
    arrays = SplitVec(*jnp.asarray(color[:, :height])), jnp.asarray(edge[:height])

    def averages(color: Vec, edge: Array, settings: RenderSettings) -> Array:
        return filter_pixels(jax.tree.map(settings.rows.with_neighbours, color), edge, settings)

    if sharding is None:
        return {"mean": np.asarray(averages(*arrays, settings))}
    mean = lambda _, arrays: averages(*arrays, settings.of_device)
    found = jax.jit(lambda arrays: on_devices(mean, settings.sharding, None, arrays))(arrays)
    return {"mean": np.asarray(process_allgather(found, tiled=True))[:UNEVEN]}


def fit_results(fit: st.Fit) -> Results:
    spheres = [np.asarray(x) for x in jax.tree.leaves(fit.scene.spheres)]
    numbers = dict(zip(("center", "radius", "color", "ka", "kd", "ks"), spheres, strict=False))
    lights = np.stack([np.asarray(scene.lights.position) for scene in fit.scenes])
    # without the steps: near the minimum rounding decides whether there is another
    judged = dict(ok=fit.trust.ok, counted=fit.counted, left_out=fit.left_out)
    judged = {name: np.asarray(x, float) for name, x in judged.items()}
    return (
        numbers | judged | {"lights": lights, "rank": np.asarray(fit.identifiability.rank, float)}
    )


def wrong_materials(scene: st.Scene) -> st.Scene:
    return eqx.tree_at(lambda s: (s.spheres.kd, s.spheres.ks), scene, replace_fn=lambda x: x * 0.6)


FREE = ("kd", "ks", "light_position")


def fits(sharding: NamedSharding | None) -> Results:
    """Fits materials to a picture whose rows the devices hold."""
    scene = scenes.three_spheres()
    target = st.render(scene, width=WIDTH, height=HEIGHT, sharding=sharding)
    return fit_results(st.fit(wrong_materials(scene), target, free=("kd", "ks"), sharding=sharding))


def auto_starts(sharding: NamedSharding | None) -> Results:
    """Fits materials and light from nothing to such a picture."""
    scene = scenes.three_spheres()
    target = st.render(scene, width=WIDTH, height=HEIGHT, sharding=sharding)
    settings = dict(free=FREE, start="auto", sharding=sharding)
    return fit_results(st.fit(wrong_materials(scene), target, **settings))


def two_pictures(sharding: NamedSharding | None) -> Results:
    """Fits two pictures, of which each process holds one."""
    scene = scenes.three_spheres()
    move = lambda s: eqx.tree_at(lambda s: s.lights.position, s, jnp.array([[-300.0, 200, 400]]))
    both = [scene, move(scene)]
    targets = np.stack([st.render(s, width=WIDTH, height=UNEVEN) for s in both])
    if sharding is not None:
        mine = targets[jax.process_index()][None] if jax.process_count() > 1 else targets
        by_host = NamedSharding(sharding.mesh, PartitionSpec("hosts"))
        targets = jax.make_array_from_process_local_data(by_host, mine)
        assert targets.is_fully_addressable == (jax.process_count() == 1)
    start = [wrong_materials(s) for s in both]
    own = ("light_position",)
    return fit_results(st.fit(start, targets, free=FREE, own=own, sharding=sharding))


def edges(sharding: NamedSharding | None) -> Results:
    """Returns a picture with covered edges, its gradient, and its normal equations of geometry."""
    # a matt sphere compiles in a fraction of the time of several spheres with shadows
    sphere = st.Spheres([[20.0, -30, 40]], [150.0], [[0.9, 0.5, 0.3]])
    scene = st.Scene(sphere, st.Lights([[200.0, 300, 500]]), antialias=1)
    target = draw_picture(scene, UNEVEN, sharding)
    other = eqx.tree_at(lambda s: s.spheres.radius, scene, replace_fn=lambda x: x * 1.02)
    problem = make_problem(other, target, ("center", "kd"), bounces=5, sharding=sharding)
    normal = normal_at(problem, problem.start())
    normal = {k: np.asarray(getattr(normal, k)) for k in ("square", "gradient", "cost")}
    return {"picture": target, **normal} | gradients(sharding, scene, UNEVEN)


COMPUTED: dict[str, Callable[[NamedSharding | None], Results]] = {
    f.__name__: f
    for f in (pictures, operations, gradients, neighbours, fits, two_pictures, auto_starts, edges)
}


def save(names: str, output: str) -> None:
    """Computes results on all devices and writes them to a file, the same in all processes."""
    assert jax.device_count() == DEVICES
    mesh = jax.make_mesh((PROCESSES, DEVICES // PROCESSES), ("hosts", "rows"))
    sharding = NamedSharding(mesh, PartitionSpec(("hosts", "rows")))
    np.savez(output, **compute(names, sharding))


def compute(names: str, sharding: NamedSharding | None) -> Results:
    every = [(name, COMPUTED[name](sharding)) for name in names.split(",")]
    return {f"{name}: {key}": value for name, found in every for key, value in found.items()}
