"""POV-Ray scenes, read: the part of POV-Ray 3.7's language that `povray.py` writes, and some more.

Statements: `#version`, `global_settings`, `camera`, `background`, `sky_sphere` and `#declare` of a
bitmap, as they are written, `light_source`, `sphere`, `plane`, and `#declare` and `#local` of
numbers, vectors and colours, in expressions of + - * / and brackets. Other objects are left out
with a warning; other directives (loops, conditions, macros of one's own) are errors, as all may
depend on them.

What a scene does not hold is said: the highlight model and the number of bounces are arguments of
`render`. A left-handed camera, which is POV-Ray's own, is that of the scene whose z is mirrored.
"""

import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import SceneWarning
from ..scene.scene import Scene
from .povray_build import Light, Plane, PovrayWorld, Sphere, build_scene
from .povray_camera import read_camera
from .povray_surface import Surface, read_surface_word, read_texture
from .povray_tokens import PovrayTokens
from .scene_text import scene_dtype, texture_at
from .tokens import Token, decode, read_bytes

_LIGHT_WORDS = {"fade_distance": 1, "fade_power": 1, "point_at": 3, "radius": 1, "falloff": 1}
_LIGHT_WORDS |= {"tightness": 1, "parallel": 0, "spotlight": 0, "cylinder": 0, "shadowless": 0}


def read_povray(path: str | os.PathLike[str], dtype: Any = None) -> Scene:
    """Reads a POV-Ray file; see above for its language.

    **Arguments:** `dtype`: float32 or float64, by default JAX's default floating dtype.

    **Returns:** a scene of single rays (antialias 0). Bitmaps are looked up beside the file.

    **Raises:** `SceneError`, with `file:line:column: what was expected, what stands there`.

    **Warns:** `SceneWarning` for each line that is not carried over as it is, and what was done.
    """
    name, dtype = os.fspath(path), scene_dtype(dtype)
    reader = PovrayReader(name, decode(name, read_bytes(path)), dtype)
    world = reader.read()
    image = lambda token, file: texture_at(reader.tokens, Path(path).parent, token, file)
    scene = build_scene(reader.tokens, world, image, dtype)
    for line, message in sorted(dict.fromkeys(world.warnings), key=lambda said: said[0]):
        warnings.warn(f"{name}:{line}: {message}", SceneWarning, stacklevel=3)
    return scene


class PovrayReader:
    """The statements of a POV-Ray file, one after the other."""

    def __init__(self, name: str, text: str, dtype: np.dtype):
        self.tokens = PovrayTokens(name, text, dtype)
        self.world = PovrayWorld()

    @np.errstate(over="ignore")  # numbers too large for float32 become inf, and are refused
    def read(self) -> PovrayWorld:
        """Reads the whole file. **Raises:** `SceneError`."""
        tokens = self.tokens
        if not tokens.peek.text:
            tokens.fail(tokens.peek, "expected a POV-Ray scene, got an empty file")
        while (word := tokens.take()).text:
            read = self._STATEMENTS.get(word.text)
            if read is not None:
                read(self, word)
            elif word.text.isidentifier() and tokens.peek.text == "{":
                tokens.skip_block()
                self.world.say(word, f"{word.text}: left out")
            else:
                tokens.fail_spelling(word, f"one of {', '.join(self._STATEMENTS)}")
        if self.world.camera is None:
            tokens.fail(word, "expected a camera, got the end of the file")
        return self.world

    def _version(self, start: Token) -> None:
        self.tokens.scalar("the version")
        self.tokens.accept(";")

    def _include(self, start: Token) -> None:
        self.world.say(start, f"#include {self.tokens.take()}: left out, with all its names")

    def _declare(self, start: Token) -> None:
        """Reads the name of a number, a vector, a colour, a bitmap, or of what is not read."""
        tokens = self.tokens
        name = tokens.take()
        if not name.text.isidentifier():
            tokens.fail_spelling(name, "a name")
        tokens.expect("=")
        if tokens.peek.text == "function":
            tokens.take()
            self._function(name)
        elif tokens.peek.text.isidentifier() and tokens.peek.text not in (*tokens.names, "rgb"):
            word = tokens.peek
            if word.text in ("color", "colour", "rgbt", "rgbf", "rgbft"):
                color, through = tokens.color()
                tokens.names[name.text] = (*color, through) if through else tuple(color)
            else:
                tokens.take()
                tokens.skip_block()
                self.world.say(word, f"{name.text}, a {word.text}: left out")
        else:
            tokens.names[name.text] = tokens.expression()
        tokens.accept(";")

    def _function(self, name: Token) -> None:
        """Reads a function: the bitmap of an `image_map`; skips others, as that of `Wrapped`."""
        tokens = self.tokens
        if tokens.peek.text == "(":
            while tokens.take().text not in (")", ""):
                pass
            tokens.skip_block()
            return
        for word in ("{", "pigment", "{", "image_map", "{"):
            tokens.expect(word, "of a bitmap's function")
        tokens.take()
        file = tokens.take()
        if len(file.text) < 3 or file.text[0] != '"' or file.text[-1] != '"':
            tokens.fail_spelling(file, "the name of a picture in quotes")
        self.world.images[name.text] = (file, file.text[1:-1])
        words = []
        while not tokens.accept("}"):
            words.append(tokens.take().text)
            if not words[-1]:
                tokens.fail(file, "the block of this picture has no }")
        if words[-4:] != ["map_type", "1", "interpolate", "2"]:
            self.world.say(file, "bitmap: wrapped around a sphere, bilinear")
        tokens.expect("}")
        tokens.expect("}")

    def _macro(self, start: Token) -> None:
        """Skips the macro that this program writes."""
        name = self.tokens.take()
        if name.text != "Wrapped":
            self.tokens.fail(name, f"macros are not read, only that named Wrapped, got {name}")
        while (word := self.tokens.take()).text != "#end":
            if not word.text:
                self.tokens.fail(start, "this #macro has no #end")

    def _global_settings(self, start: Token) -> None:
        """Reads the ambient light, the gamma and the number of bounces."""
        tokens = self.tokens
        opened = tokens.expect("{")
        while tokens.inside(opened):
            word = tokens.take()
            if word.text == "charset":
                tokens.take()
            elif word.text == "ambient_light":
                color, _ = tokens.color()
                self.world.ambient = (word, np.array(color))
            elif word.text in ("assumed_gamma", "max_trace_level", "adc_bailout"):
                value = tokens.scalar(word.text)
                if word.text == "assumed_gamma" and value != 1:
                    self.world.say(word, f"assumed_gamma {value:g}: colours are taken as linear")
                if word.text == "max_trace_level" and value != 6:
                    bounces = max(int(value) - 1, 0)
                    self.world.say(
                        word, f"max_trace_level {value:g}: render with {bounces} bounces"
                    )
            elif tokens.peek.text == "{":
                tokens.skip_block()
                self.world.say(word, f"{word.text}: left out")
            else:
                tokens.expression()
                self.world.say(word, f"{word.text}: left out")

    def _camera(self, start: Token) -> None:
        if self.world.camera is not None:
            line = self.world.camera.token.line
            self.tokens.fail(start, f"a camera was given before, on line {line}")
        self.world.camera = read_camera(self.tokens, start)

    def _background(self, start: Token) -> None:
        self.tokens.expect("{")
        self.world.background, _ = self.tokens.color()
        self.tokens.expect("}")

    def _sky_sphere(self, start: Token) -> None:
        surface = Surface()
        read_texture(self.tokens, surface)
        if surface.image:
            self.world.sky = (start, surface.image)
        else:
            self.world.background = surface.color

    def _light_source(self, start: Token) -> None:
        """Reads a light; kinds that no light here is become lights at points."""
        tokens = self.tokens
        opened = tokens.expect("{")
        position = tokens.vector("a position")
        tokens.accept(",")
        color, _ = tokens.color()
        numbers: dict[str, Any] = {}
        while tokens.inside(opened):
            word = tokens.take()
            if word.text not in _LIGHT_WORDS:
                tokens.fail_unknown(word, "a light", (*_LIGHT_WORDS, "}"))
            count = _LIGHT_WORDS[word.text]
            read = {0: lambda: True, 1: tokens.scalar, 3: lambda: tokens.vector("a point")}[count]
            numbers[word.text] = read()
            if word.text in ("spotlight", "cylinder"):
                self.world.say(word, f"{word.text}: it shines in all directions")
            elif word.text == "shadowless":
                self.world.say(word, "shadowless: the light casts shadows")
        direction = None
        if "parallel" in numbers:
            direction = position - numbers.get("point_at", np.zeros(3))
            if not direction.any():
                tokens.fail(start, "a parallel light must not be where it points at")
        fade = None
        if numbers.get("fade_power", 0) and direction is None:
            fade = numbers.get("fade_distance", 0.0)
            if numbers["fade_power"] != 2 or not fade > 0:
                self.world.say(start, "fade_power other than 2: the light does not fade")
                fade = None
        self.world.lights.append(Light(start, position, color, direction, fade))

    def _sphere(self, start: Token) -> None:
        """Reads a sphere, or the shadow of a transparent one."""
        tokens = self.tokens
        opened = tokens.expect("{")
        center = tokens.vector("a centre")
        tokens.accept(",")
        at = tokens.peek
        radius = tokens.scalar("a radius")
        if not radius > 0:
            tokens.fail(at, f"the radius must be greater than 0, got {radius:g}")
        surface = Surface()
        flags = self._object(opened, surface, "a sphere")
        if {"no_image", "no_reflection"} <= flags:
            self.world.shadows.append((start, center, radius))
        else:
            sphere = Sphere(start, center, radius, surface, "no_shadow" in flags)
            self.world.spheres.append(sphere)

    def _plane(self, start: Token) -> None:
        tokens = self.tokens
        opened = tokens.expect("{")
        at = tokens.peek
        normal = tokens.vector("a normal")
        tokens.accept(",")
        height = tokens.scalar("a distance")
        if not normal.any():
            tokens.fail(at, "the normal of a plane must not be 0 0 0")
        surface = Surface()
        flags = self._object(opened, surface, "a plane")
        for flag in flags:
            self.world.say(start, f"{flag} of a plane: left out")
        if surface.kt:
            self.world.say(start, "a transparent plane: it is opaque")
        self.world.planes.append(Plane(start, normal, height, surface))

    def _object(self, opened: Token, surface: Surface, what: str) -> set[str]:
        """Reads an object's surface and its flags, up to its end. **Returns:** the flags."""
        tokens, flags = self.tokens, set()
        known = ("no_shadow", "no_image", "no_reflection")
        while tokens.inside(opened):
            if read_surface_word(tokens, surface):
                continue
            word = tokens.take()
            if word.text == "interior_texture":  # the far wall, which is not seen
                tokens.skip_block()
            elif word.text == "interior":
                self._interior()
            elif word.text in known:
                flags.add(word.text)
            else:
                words = ("texture", "pigment", "finish", "interior", "interior_texture", *known)
                tokens.fail_unknown(word, what, words)
        return flags

    def _interior(self) -> None:
        tokens = self.tokens
        tokens.expect("{")
        if tokens.accept("ior"):
            word, ior = tokens.last, tokens.scalar("ior")
            if ior != 1:
                self.world.say(word, f"ior {ior:g}: rays go straight on")
        if not tokens.accept("}"):
            tokens.fail_unknown(tokens.take(), "an interior", ("ior", "}"))

    # the statements by their first word
    _STATEMENTS = {  # noqa: RUF012
        "#version": _version,
        "#include": _include,
        "#declare": _declare,
        "#local": _declare,
        "#macro": _macro,
        "global_settings": _global_settings,
        "camera": _camera,
        "background": _background,
        "sky_sphere": _sky_sphere,
        "light_source": _light_source,
        "sphere": _sphere,
        "plane": _plane,
    }
