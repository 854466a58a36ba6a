"""Our pictures against POV-Ray's, and the text that is written for it.

The references were rendered by data/references/make_references.py. They hold 16-bit numbers, so
half a step, 7.6e-6, is the least difference to expect; bitmaps add about as much, since POV-Ray
keeps them in float32. A pixel whose ray grazes an edge may fall on either side (`tie_pixels`).
Those with "samples" are averages of many rays, for pictures whose edges are covered by area.
"""

import dataclasses
import importlib.util
import json
import re
import shutil
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.picture_files import P3_D50, icc_profile, write_raw
from helpers.scenes import SCENES, VIEWS, with_camera

import spheretrace_jax as st
from spheretrace_jax.files.povray import povray_text, write_povray
from spheretrace_jax.scene.camera import pixel_rays

FOLDER = Path(__file__).parents[2] / "data" / "references"
REFERENCES = json.loads((FOLDER / "references.json").read_text())
TOLERANCE = 2e-3
TEXTURES = {"transmission", "textures", "sky", "pole"}


def load(name: str) -> st.Scene:
    return st.load_scene(FOLDER / f"{name}.txt", dtype=np.float64)


def small_scene(**options) -> st.Scene:
    spheres = st.Spheres(jnp.array([[0.0, 0, 0], [150, 20, 0]]), 40.0, ks=0.3, **options)
    return st.Scene(
        spheres, st.Lights([[100.0, 500, 800]]), textures=[st.Texture(np.ones((4, 8, 3)))]
    )


SHARP = [reference for reference in REFERENCES if "samples" not in reference]
SMOOTH = [reference for reference in REFERENCES if "samples" in reference]


@pytest.mark.slow
@pytest.mark.parametrize("reference", SMOOTH, ids=lambda reference: reference["name"])
def test_covered_edges_are_near_povrays_many_rays(reference):
    options = {key: reference[key] for key in ("width", "height", "highlight", "bounces")}
    theirs = st.read_image(FOLDER / f"{reference['name']}.png", colorspace="linear")
    assert theirs.max() < 1
    error = lambda ours: np.linalg.norm(np.asarray(ours) - theirs) / np.linalg.norm(theirs)
    scene = load(reference["name"])
    sharp = scene.with_antialias(0)
    assert error(st.render(scene, **options)) < 4e-3
    assert error(st.render(scene, **options, samples=2)) < 1.2e-3
    assert error(st.render(sharp, **options)) > 3e-2, "one ray per pixel is far off"


@pytest.mark.slow
@pytest.mark.parametrize(
    "reference",
    [  # every other one is enough to show that something broke
        pytest.param(reference, id=reference["name"], marks=pytest.mark.slow if k % 2 else ())
        for k, reference in enumerate(SHARP)
    ],
)
def test_picture_equals_that_of_povray(reference):
    name, width, height = (reference[key] for key in ("name", "width", "height"))
    options = {key: reference[key] for key in ("width", "height", "highlight", "bounces")}
    ours = np.asarray(st.render(load(name), **options))
    theirs = st.read_image(FOLDER / f"{name}.png", colorspace="linear")
    assert theirs.shape == (height, width, 3)
    assert 0.2 < theirs.max() < 1, "a picture that clips, or is black, compares nothing there"
    error = np.abs(np.minimum(ours, 1) - theirs).max(axis=-1)
    off = error > TOLERANCE
    assert off.sum() <= reference["tie_pixels"], f"{off.sum()} pixels, first {np.argwhere(off)[:5]}"
    assert error[~off].max() < (3e-5 if name in TEXTURES else 8e-6)


def test_few_pixels_may_differ():
    for reference in REFERENCES:
        assert reference["tie_pixels"] <= round(1e-4 * reference["width"] * reference["height"])


def test_references_cover_every_feature():
    needs = [st.needs(load(reference["name"])) for reference in REFERENCES]
    covered = {
        f.name for f in dataclasses.fields(st.Needs) if any(getattr(n, f.name) for n in needs)
    }
    assert covered >= {
        "shadows", "highlights", "inside", "reflection", "transmission", "branching", "textures",
        "planes", "checkers", "background",
    }  # fmt: skip


@pytest.mark.skipif(shutil.which("povray") is None, reason="POV-Ray is not installed")
@pytest.mark.parametrize("name", ["exponents_blinn", "sky", "transmission"])
def test_povray_draws_the_reference_again(name, tmp_path):
    spec = importlib.util.spec_from_file_location("references", FOLDER / "make_references.py")
    references = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(references)
    references.render(next(r for r in REFERENCES if r["name"] == name), tmp_path)
    now, then = (
        st.read_image(folder / f"{name}.png", colorspace="linear") for folder in (tmp_path, FOLDER)
    )
    np.testing.assert_allclose(now, then, atol=2 / 65535)


@pytest.mark.parametrize("reference", REFERENCES, ids=lambda reference: reference["name"])
def test_text_holds_finite_numbers_only(reference):
    text = povray_text(load(reference["name"]))
    assert "nan" not in text and "inf" not in text.replace("interior", "")


def test_nan_is_refused():
    with pytest.raises(st.SceneError, match="holds nan"):
        povray_text(small_scene(kd=jnp.nan))


def test_texture_without_a_file_is_refused():
    with pytest.raises(ValueError, match="a texture is in no file") as error:
        povray_text(small_scene(pic=1))
    assert "\n" not in str(error.value)


def test_texture_that_no_sphere_wears_needs_no_file():
    assert "image_map" not in povray_text(small_scene())


def test_bounces_count_the_ray_from_the_eye():
    assert "max_trace_level 4 " in povray_text(small_scene(kgr=0.5), bounces=3)


def test_exponent_0_is_a_constant_highlight():
    assert "specular 0.3 roughness 1e10" in povray_text(small_scene(exponent=0.0))


@pytest.mark.parametrize(
    "options, what",
    [
        ({"kt": 1.0}, "kt counts as at most"),
        ({"kt": 0.5, "kgr": 0.5}, "do not count as bounces"),
        ({"radius": 100.0, "kt": 0.5}, "far walls"),
        ({"radius": 1e-3}, "nearer than"),
        ({"ior": 1.5}, "POV-Ray has no coats"),
    ],
)
def test_what_is_not_exact_is_said_first(options, what):
    options = {"radius": 40.0, **options}
    spheres = st.Spheres([[0.0, 0.0, 0.0], [150.0, 20.0, 0.0]], **options)
    text = povray_text(st.Scene(spheres, st.Lights([[100.0, 500.0, 800.0]])))
    assert text.startswith("// not exact: ") and what in text.split("#version")[0]


def test_directional_lights_are_parallel():
    spheres = st.Spheres([[0.0, 0.0, 0.0]], 40.0)
    scene = st.Scene(spheres, st.Lights([[0.0, 3, 4]], directional=True), st.Camera(mu=500.0))
    text = povray_text(scene)
    assert "light_source { <0.0, 30000.0, 40000.0> rgb <1.0, 1.0, 1.0> parallel point_at" in text
    assert "not exact" not in text
    floor = eqx.tree_at(lambda s: s.planes, scene, st.Planes([[0.0, 0, 0]], [[0.0, 0, 1]]))
    assert "no directional light's shadow far outside" in povray_text(floor)


def test_falloff_is_povray_s_fading():
    spheres = st.Spheres([[0.0, 0.0, 0.0]], 40.0)
    text = povray_text(st.Scene(spheres, st.Lights([[0.0, 3, 4]], (0.5, 1, 2), falloff=300.0)))
    (light,) = [line for line in text.splitlines() if line.startswith("light_source")]
    red, distance = (
        float(light.split(w)[1].split(e)[0]) for w, e in (("rgb <", ","), ("nce ", " "))
    )
    for r in (30.0, 300.0, 5000.0):  # POV-Ray's factor of a light that fades with power 2
        seen = red * 2 / (1 + (r / distance) ** 2)
        np.testing.assert_allclose(seen, 0.5 * (300 / r) ** 2, rtol=1e-7)
    assert "fade_power 2" in light and "not exact" not in text


def test_lecture_scene_is_exact():
    assert "not exact" not in povray_text(load("nine_spheres"))


def povray_rays(text: str, columns, rows, size) -> tuple[np.ndarray, np.ndarray]:
    """Returns the rays of a camera in POV-Ray's language, by the formulas of its reference."""
    lines = text[text.index("camera {") :].splitlines()[1:6]
    kind, *vectors = (line.split(maxsplit=1) for line in lines)
    names = dict(image_width=size[0], image_height=size[1], array=np.array)
    vector = lambda words: eval(re.sub("<(.*?)>", r"array([\1])", words), names)
    location, right, up, direction = (vector(words) for _, words in vectors)
    assert [name for name, *_ in vectors] == ["location", "right", "up", "direction"]
    across = (columns / size[0] - 0.5)[:, None] * right + (0.5 - rows / size[1])[:, None] * up
    if kind == ["orthographic"]:
        return location + across, np.broadcast_to(direction, across.shape)
    assert kind == ["perspective"]
    return np.broadcast_to(location, across.shape), direction + across


@pytest.mark.parametrize("view", [None, *VIEWS])
def test_its_camera_has_our_rays(view):
    scene = with_camera(SCENES["shadows"], **VIEWS.get(view, {}))
    columns, rows, size = np.array([0.5, 20, 63]), np.array([3.0, 30, 47.5]), (64, 48)
    origin, direction = povray_rays(povray_text(scene), columns, rows, size)
    ray = pixel_rays(scene.camera, jnp.asarray(columns), jnp.asarray(rows), size)
    as_rows = lambda v: np.stack([np.broadcast_to(x, 3) for x in (v.x, v.y, v.z)], axis=-1)
    np.testing.assert_allclose(origin, as_rows(ray.origin), atol=1e-11)
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    np.testing.assert_allclose(direction, as_rows(ray.direction), atol=1e-13)


def test_parallel_rays_in_a_bubble_are_not_exact():
    scene = with_camera(small_scene(kt=0.5), orthographic=True, mu=jnp.array(30.0))
    assert "// not exact: far walls" in povray_text(scene)
    assert "far walls" not in povray_text(with_camera(scene, mu=jnp.array(500.0)))


def test_file_is_named_after_its_scene_but_not_its_folder(tmp_path):
    write_povray(tmp_path / "a.pov", small_scene(), scene_path=tmp_path / "a.txt")
    lines = (tmp_path / "a.pov").read_text().splitlines()
    assert lines[0] == "// made from a.txt"
    assert [file.name for file in tmp_path.iterdir()] == ["a.pov"]


@pytest.mark.parametrize(
    ("name", "attributes"),
    [
        ("a.png", {"Orientation": 6}),
        ("a.png", {"ICCProfile": icc_profile(P3_D50)}),
        ("a.png", {"oiio:ColorSpace": "lin_rec709_scene"}),
        ("a.png", {"alpha": 3}),
        ("a.exr", {"window": (1, 1, 9, 9)}),
    ],
)
def test_a_texture_that_pov_ray_would_read_otherwise_is_refused(name, attributes, tmp_path):
    numbers = np.full((4, 8, 4 if "alpha" in attributes else 3), 100, np.uint8)
    numbers = numbers.astype(np.float32) if name == "a.exr" else numbers
    file = str(tmp_path / name)
    texture = st.Texture(np.ones((4, 8, 3)), file)
    spheres = st.Spheres([[0.0, 0.0, 0.0]], [40.0], pic=(1,))
    scene = st.Scene(spheres, st.Lights([[100.0, 500, 800]]), textures=[texture])
    write_raw(file, numbers[..., :3])
    assert f'"{file}" gamma {"1" if name == "a.exr" else "srgb"}' in povray_text(scene)
    write_raw(file, numbers, **attributes)
    with pytest.raises(st.SceneError, match="POV-Ray would read this picture without its") as error:
        povray_text(scene)
    assert str(error.value).startswith(f"{file}: ")
