"""A differentiable ray caster for worlds of spheres, on JAX."""

from .base.errors import (
    InputError as InputError,
    PictureError as PictureError,
    SceneError as SceneError,
    SceneWarning as SceneWarning,
)
from .files.images import read_image as read_image, write_image as write_image
from .files.povray import write_povray as write_povray
from .files.scene_text import load_scene as load_scene, save_scene as save_scene
from .fit import Fit as Fit, fit as fit
from .rendering.render import render as render
from .scene.needs import Needs as Needs, needs as needs
from .scene.scene import (
    BackPlane as BackPlane,
    Camera as Camera,
    Lights as Lights,
    Planes as Planes,
    Scene as Scene,
    Spheres as Spheres,
    Texture as Texture,
)
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
