"""Rendering: from a scene to a picture."""

from jax.sharding import NamedSharding

from ..base.types import Highlight, Picture
from ..base.vec import Vec
from ..scene.needs import Needs
from ..scene.scene import Scene, check_scene
from ..scene.settings import RenderSettings, render_settings
from ..tracing.context import build_context
from ..xla.jit import compiled
from ..xla.sharding import on_devices, replicate
from .pixel_filter import filter_pixels
from .samples import render_samples


def render(
    scene: Scene,
    *,
    width: int = 512,
    height: int = 512,
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int = 1,
    needs: Needs | None = None,
    sharding: NamedSharding | None = None,
) -> Picture:
    """Renders a scene: a pure function, differentiable in every array of the scene.

    Compiled once per shape and need of the scene; other numbers never compile again. Where the
    scene's antialias flag is 1, pixels are averages over their area: edges are covered
    analytically, and the derivatives say how the picture changes as they move. Where it is 0,
    pixels are single rays, and derivatives are those of the surfaces' colours alone. For
    derivatives by ks, kgr or kt where they are 0, pass `needs(scene, free=("ks", "kgr", "kt"))`.

    **Arguments:**

    - `width`, `height`: the picture's size in pixels.
    - `highlight`: `"phong"` for (R.V)^n or `"blinn"` for (H.N)^n.
    - `bounces`: how many reflections and transmissions n a path goes through at most. Where an
      object both reflects and transmits, 2^n paths are followed.
    - `samples`: k for the average of k x k parts of each pixel, each a picture of its own:
      edges covered analytically or single rays, as the antialias flag says. By default 1.
    - `needs`: what to compute, by default what `spheretrace_jax.needs(scene)` finds. Under jit,
      grad and vmap numbers that are traced are not known, and all that they could switch on is
      computed: where the whole scene is traced, needs found outside make leaner pictures.
    - `sharding`: how the picture's rows lie on several devices, each of which computes its own:
      `NamedSharding(mesh, PartitionSpec("rows"))`, where rows is an axis of the mesh or several.

    **Returns:** linear RGB of shape `(height, width, 3)`, unclamped, in the scene's dtype. Row 0
    is the top. With `sharding`, rows lie on their devices, if these divide the height; if not,
    every device holds all of them. Where devices are those of several processes, all of these call
    `render` with the same arguments, and `jax.experimental.multihost_utils.process_allgather(
    picture, tiled=True)` is the whole picture as a numpy array.

    **Raises:** `InputError` for sizes, samples or bounces out of range, unknown highlights,
    shardings that divide other than rows, and scenes whose arrays do not fit.
    """
    scene = check_scene(scene)
    checked = render_settings(
        scene, width, height, highlight=highlight, bounces=bounces, samples=samples, needs=needs,
        sharding=sharding,
    )  # fmt: skip
    return draw(replicate(scene, checked.sharding), checked)


@compiled
def draw(scene: Scene, settings: RenderSettings) -> Picture:
    """Renders a picture whose settings are already checked."""
    if settings.sharding is None:
        return _draw_rows(scene, settings)
    of_device = lambda inputs, _: _draw_rows(*inputs)
    return on_devices(of_device, settings.sharding, (scene, settings.of_device))[: settings.height]


def draw_replicated(scene: Scene, settings: RenderSettings) -> Picture:
    """Renders a picture that lies whole on each device."""
    return replicate(draw(scene, settings), settings.sharding)


def _draw_rows(scene: Scene, settings: RenderSettings) -> Picture:
    """Renders the rows of the picture that are to be computed."""
    color, edge = render_samples(build_context(scene, settings))
    return filter_pixels(color, edge, settings) if isinstance(color, Vec) else color
