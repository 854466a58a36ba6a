"""What notebooks show: a scene's picture beside its table, the summaries of fits and lights.

A display never fails: what cannot be drawn is shown as its text.
"""

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from ..base.errors import InputError
from ..calibration.lights import BallLights
from ..fit import Fit
from ..rendering.render import render
from ..scene.arrays import is_traced
from ..scene.scene import Scene
from . import page
from .figures import picture_png
from .lights_page import lights_table
from .parameter_rows import number_words

# The height of a scene's picture, in pixels, and limits of what is drawn without being asked for:
# bounces, and objects. A picture of nine spheres then takes a second, mostly to compile.
_HEIGHT, _BOUNCES, _MOST_OBJECTS = 160, 1, 200

# The limit of the spheres in a table, the first ones.
_MOST_ROWS = 12

_GRADES = {"good": "#2a9d3a", "usable": "#c98a00", "bad": "#c62828"}


def scene_html(scene: Scene) -> str:
    """Returns a scene's small picture beside its table."""
    try:
        text = str(scene)
    except InputError as error:
        return _text(str(error))
    if is_traced(scene):
        return _text(text)
    return _row(_picture(scene), f"{_text(text)}{_spheres(scene)}")


def fit_html(fit: Fit) -> str:
    """Returns a fit's verdict and remarks beside the picture of what is found."""
    first, *others = str(fit).splitlines()
    color = _GRADES[page.GRADES.get(fit.trust.grade, "bad")]
    verdict = f"<b style='color: {color}'>{escape(first)}</b>"
    hint = "<i>found.report(&quot;fit.html&quot;) writes a page with all of it</i>"
    return _row(_picture(fit.scene), f"{verdict}{page.listed(others)}{hint}")


def lights_html(found: BallLights) -> str:
    """Returns the table of the lights of photographs."""
    return lights_table(found)


def _picture(scene: Scene) -> str:
    """Returns a small picture; nothing for scenes that take long or cannot be drawn.

    The next picture of as many objects takes milliseconds, as JAX keeps the program.
    """
    if scene.objects > _MOST_OBJECTS:
        return ""
    flat = scene.with_antialias(0)  # compiles in a third of the time
    try:
        picture = render(flat, width=_HEIGHT, height=_HEIGHT, bounces=_BOUNCES, samples=2)
    except InputError:
        return ""
    return page.image(picture_png(np.asarray(picture)), "the scene")


def _spheres(scene: Scene) -> str:
    """Returns the table of the first spheres."""
    s = scene.spheres
    names: Sequence[str] = ("center", "radius", "color", "ka", "kd", "ks", "exponent", "kgr", "kt")
    arrays: list[Any] = [np.asarray(getattr(s, name)) for name in names]
    shown = range(min(len(s), _MOST_ROWS))
    rows = [[str(i + 1), *(number_words(x[i]) for x in arrays)] for i in shown]
    more = page.paragraph(f"and {len(s) - len(rows)} more spheres") * (len(s) > len(rows))
    return page.table(("sphere", *names), rows) + more


def _text(text: str) -> str:
    return f"<pre>{escape(text)}</pre>"


def _row(left: str, right: str) -> str:
    style = "display: flex; gap: 1em; align-items: flex-start; flex-wrap: wrap"
    return f"<div style='{style}'><div>{left}</div><div>{right}</div></div>"
