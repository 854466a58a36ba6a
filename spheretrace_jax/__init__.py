"""A differentiable ray caster for worlds of spheres, on JAX."""

from .base.errors import (
    InputError as InputError,
    PictureError as PictureError,
    PictureWarning as PictureWarning,
    SceneError as SceneError,
    SceneWarning as SceneWarning,
)
from .calibration.lights import BallLights as BallLights, lights as lights
from .calibration.outline import ball_from_mask as ball_from_mask
from .calibration.photo_outline import ball_from_photo as ball_from_photo
from .display.progress import show_progress as show_progress
from .display.show import show as show, to_srgb as to_srgb
from .files.formats import load_scene as load_scene
from .files.images import (
    read_image as read_image,
    read_mask as read_mask,
    write_image as write_image,
)
from .files.mitsuba import write_mitsuba as write_mitsuba
from .files.povray import write_povray as write_povray
from .files.scene_writer import save_scene as save_scene
from .fit import Fit as Fit, fit as fit
from .fit.solution import solution as solution
from .rendering.layers import Layers as Layers, render_layers as render_layers
from .rendering.render import render as render
from .scene.camera import Camera as Camera
from .scene.lights import Lights as Lights
from .scene.needs import Needs as Needs, needs as needs
from .scene.planes import BackPlane as BackPlane, Planes as Planes
from .scene.scene import Scene as Scene
from .scene.spheres import Spheres as Spheres
from .scene.texture import Texture as Texture
from .scene.values import replace as replace, values as values
from .study.checks.condition import Condition as Condition, check_condition as check_condition
from .study.checks.gradients import (
    GradientTable as GradientTable,
    check_gradients as check_gradients,
)
from .study.checks.stability import (
    StabilityTable as StabilityTable,
    check_stability as check_stability,
)
from .study.study import Study as Study, study as study

__version__ = "0.1.0"

show_progress()  # where the session is interactive
