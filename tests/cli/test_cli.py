"""The command line, run inside the test's own process but for what only another one can show."""

import os
import re
from pathlib import Path

import equinox as eqx
import numpy as np
import OpenImageIO as oiio
import pytest
from helpers.commands import FIT, TEXT, files, fill, python, status_of

import spheretrace_jax as st

SIZE = dict(width=32, height=24)


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Enters a folder with a scene, its picture, a start, and files that cannot be read."""
    monkeypatch.chdir(tmp_path)
    fill(tmp_path)
    Path("bad.txt").write_text(TEXT.replace("90 0 0 80", "90 0 0 -80"))
    Path("cut.png").write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR")
    Path("words.png").write_text("no picture\n")
    return tmp_path


@pytest.fixture
def spheretrace(folder, capfd):
    """Runs the program: `(status, stdout, stderr)`."""
    return lambda *words: (status_of(*words), *capfd.readouterr())


# --- render ---------------------------------------------------------------------------------------

RENDER = ("render", "scene.txt", "-o", "out.exr", "--size", "32x24")


def test_render_writes_what_render_returns_and_each_option_matters(spheretrace):
    Path("scene.txt").write_text(TEXT.replace("8  0 0 0", "8 .5 0 0"))
    scene = st.load_scene("scene.txt", np.float32)
    pictures = []
    for words in ([], ["--highlight", "blinn"], ["--bounces", "0"], ["--samples", "3"]):
        status, out, err = spheretrace(*RENDER, *words)
        assert (status, err) == (0, "")
        assert re.fullmatch(r"out\.exr: 32 x 24, \d+\.\d\d s with compilation\n", out)
        options = {n.removeprefix("--"): v for n, v in zip(words[::2], words[1::2], strict=True)}
        options = {n: int(v) if v.isdigit() else v for n, v in options.items()}
        pictures.append(st.read_image("out.exr"))
        np.testing.assert_array_equal(pictures[-1], st.render(scene, **SIZE, **options))
    for i, picture in enumerate(pictures):
        assert all(np.abs(picture - other).max() > 0.01 for other in pictures[:i])


def test_render_in_float64_is_the_picture_rounded_once(spheretrace):
    assert spheretrace(*RENDER, "--dtype", "float64")[0] == 0
    exact = np.asarray(st.render(st.load_scene("scene.txt", np.float64), **SIZE))
    np.testing.assert_array_equal(st.read_image("out.exr"), exact.astype(np.float32))


@pytest.mark.parametrize(
    ("name", "words", "kind", "linear"),
    [
        ("out.png", (), "uint8", False),
        ("out.png", ("--bits", "16"), "uint16", False),
        ("out.png", ("--colorspace", "linear"), "uint8", True),
        ("out.exr", (), "float", True),
        ("out.exr", ("--bits", "16"), "half", True),
        ("out.exr", ("--colorspace", "srgb"), "float", False),
        ("out.tif", ("--bits", "32"), "float", True),
        ("out.tif", ("--bits", "32", "--colorspace", "srgb"), "float", False),
        ("out.ppm", (), "uint8", False),
    ],
)
def test_render_writes_numbers_as_it_is_told(name, words, kind, linear, spheretrace):
    assert spheretrace("render", "scene.txt", "-o", name, "--size", "32x24", *words)[0] == 0
    source = oiio.ImageInput.open(name)
    assert str(source.spec().format) == kind
    exact = np.asarray(st.render(st.load_scene("scene.txt", np.float32), **SIZE))
    found = st.read_image(name, "linear" if linear else "srgb")
    np.testing.assert_allclose(found, np.clip(exact, 0, 1), rtol=0, atol=0.5 / 255 * 2.3)


def test_a_rendered_picture_holds_its_scene(spheretrace, folder):
    assert spheretrace(*RENDER)[0] == 0
    text = oiio.ImageInput.open("out.exr").spec().getattribute("ImageDescription")
    Path("again.txt").write_text(text)
    assert eqx.tree_equal(st.load_scene("again.txt"), st.load_scene("scene.txt"))


def test_a_broken_rule_of_the_lecture_is_one_line_of_warning(spheretrace):
    Path("scene.txt").write_text(TEXT.replace(".6 .3", ".9 .3"))
    status, out, err = spheretrace(*RENDER)
    rule = "scene.txt:6:23: ka + kd is 1.1, the lecture's rule is at most 1"
    assert (status, err) == (0, f"spheretrace: warning: {rule}\n") and out


# --- info and convert -----------------------------------------------------------------------------


def test_info_shows_the_scene_and_what_is_left_out_and_why(spheretrace):
    status, out, err = spheretrace("info", "scene.txt")
    assert (status, err) == (0, "")
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert lines[:3] == [
        "scene.txt: 2 spheres, 1 light, 0 planes, 0 textures",
        "camera: theta -0.01, phi 0.01, mu 500, distance 800, window 512",
        "light 1: at 100 500 800, color 1 1 1",
    ]
    assert "1 -90 0 0 80 0.9 0.3 0.1 0.2 0.6 0.3 8 0 0 0" in lines
    assert "2 90 0 0 70 0.2 0.4 0.8 0.3 0.5 0.4 12 0 0 0" in lines
    assert "highlights yes some ks > 0" in lines
    assert any(re.fullmatch(r"reflection left out \+\d+% every kgr is 0", line) for line in lines)


def test_info_shows_the_first_of_many_spheres(spheretrace):
    Path("scene.txt").write_text("0 0 9 9\n0\n0\n60\n" + "1 2 3 4 1 1 1 .2 .7 0 1 0 0 0\n" * 60)
    status, out, _ = spheretrace("info", "scene.txt")
    assert status == 0 and "and 10 more spheres" in out


CHECK = ("check", "scene.txt", "--size", "16x12", "--bounces", "0")


@pytest.mark.slow
def test_check_says_that_all_is_well_or_what_is_not(spheretrace):
    status, out, err = spheretrace(*CHECK, "--report", "check.html")
    assert (status, err) == (0, "")
    page = Path("check.html").read_text()
    assert out.endswith("wrote check.html\n") and page.count("class='grade good'") == 3
    assert "<h1>Check of scene.txt</h1>" in page and "http" not in page
    text = " ".join(out.split())
    assert "derivatives: forward mode, reverse mode and differences agree" in text
    assert re.search(r"spheres.exponent ( *\d\.\de[+-]\d\d){3} +0 +yes", text)
    assert "left out, as every kgr is 0: spheres kgr" in text
    assert "single rays, which have no derivative where an edge moves" in text
    assert "float32 shows the same as float64" in text
    assert "a fit of color, ka, kd, ks, light_position is well conditioned: 13 of 15" in text
    assert "spheres 1, 2: the scale of color against ka and kd is not determined" in text


def test_check_exits_with_1_where_float32_fails(spheretrace):
    """Checks a scene in lengths of 1e20, whose squares overflow."""
    text = TEXT.replace("500 800 //", "5e20 8e20 //").replace("100 500 800", "1e20 5e20 8e20")
    text = text.replace("-90 0 0 80", "-9e19 0 0 8e19").replace("90 0 0 70", "9e19 0 0 7e19")
    Path("scene.txt").write_text(text + "window 5.12e20\n")
    status, out, err = spheretrace(*CHECK)
    text = " ".join(out.split())
    assert (status, err) == (1, "")
    assert "differences agree" in text and "float32 does NOT show the same as float64" in text
    assert "squares of lengths leave the range of float32" in text
    assert "is well conditioned: 13 of 15" in text


def test_convert_writes_a_scene_for_povray(spheretrace):
    status, out, err = spheretrace("convert", "scene.txt", "out.pov", "--highlight", "blinn")
    assert (status, err) == (0, "")
    assert out.startswith("out.pov: render it with povray ")
    text = Path("out.pov").read_text()
    assert text.startswith("// made from scene.txt\n") and text.count("sphere {") == 2
    assert "specular" in text


# --- fit ------------------------------------------------------------------------------------------


def test_fit_finds_the_scene_and_reports_it(spheretrace):
    status, out, err = spheretrace(*FIT, "--free", "kd, ks", "--report", "new/report")
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert re.fullmatch(
        r"fitted\.txt: converged after \d+ steps, root-mean-square residual \d\.\d\de-\d\d",
        lines[0],
    )
    names = ("comparison.png", "cost.png", "report.md", "report.html")
    report = [f"new/report/{name}" for name in names]
    assert lines[1:] == report
    found = st.load_scene("fitted.txt", np.float64)
    truth = st.load_scene("scene.txt", np.float64)
    np.testing.assert_allclose(found.spheres.kd, truth.spheres.kd, rtol=1e-6)  # EXR is float32
    np.testing.assert_allclose(found.spheres.ks, truth.spheres.ks, rtol=1e-6)
    assert eqx.tree_equal(found.lights, truth.lights)
    for file in report[:2]:
        picture = st.read_image(file)
        assert min(picture.shape[:2]) > 100 and picture.std() > 0.1
    text = Path(report[2]).read_text()
    assert text.startswith("# Fit\n\nConverged after ")
    for link in re.findall(r"!\[[^]]+\]\(([^)]+)\)", text):
        assert Path("new/report", link).is_file()
    table = [line for line in text.splitlines() if line.startswith("|")]
    assert table[:2] == ["| parameter | object | before | after | +- |", "|---|---|---|---|---|"]
    rows = [line.strip("|").split("|") for line in table[2:]]
    assert [[cell.strip() for cell in row[:4]] for row in rows] == [
        ["kd", "sphere 1", "0.4", "0.6"],
        ["kd", "sphere 2", "0.4", "0.5"],
        ["ks", "sphere 1", "0.2", "0.3"],
        ["ks", "sphere 2", "0.2", "0.4"],
    ]
    assert all(0 < float(row[4]) < 1e-5 for row in rows)


def test_fit_of_some_spheres(spheretrace):
    options = "--free kd:2,ks --tie ks --bounds kd:.1..0.45 --noise .01 --priors ks:.2+-10"
    scene = st.load_scene("start.txt", np.float64)
    status, out, err = spheretrace(
        *FIT, *options.split(), "--brightest", ".95,inf,1", "--report", "r"
    )
    assert (status, err) == (0, "") and "at its bound: sphere 2's kd" in out
    assert "usable" in out
    assert "what is known of ks counts: priors, as given" in out
    found = st.load_scene("fitted.txt", np.float64).spheres
    np.testing.assert_array_equal(found.kd, [scene.spheres.kd[0], 0.45])
    assert found.ks[0] == found.ks[1]
    rows = [
        row.split("|")[1:3]
        for row in Path("r/report.md").read_text().splitlines()
        if "sphere " in row and row[0] == "|"
    ]
    assert [(a.strip(), b.strip()) for a, b in rows] == [
        ("kd", "sphere 2"), ("ks", "sphere 1"), ("ks", "sphere 2"),
    ]  # fmt: skip


def test_a_fit_that_runs_out_of_steps_is_written_and_exits_with_1(spheretrace):
    status, out, err = spheretrace(*FIT, "--free", "kd,ks", "--max-steps", "1")
    assert (status, err) == (1, "")
    assert out.startswith(
        "fitted.txt: NOT converged (the maximum number of steps, max_steps, is reached"
    )
    assert " after 1 steps, " in out
    assert len(st.load_scene("fitted.txt").spheres) == 2


# --- mistakes -------------------------------------------------------------------------------------

FREE = (
    "color, ka, kd, ks, exponent, kgr, kt, ior, center, radius, light_position, light_direction, "
    "light_color, theta, phi, mu, distance, roll, look_at, principal_point, pixel_aspect, exposure"
)

MISTAKES = {
    "a bad scene to check": (
        "check bad.txt",
        "bad.txt:6:9: radius must be greater than 0, got -80",
    ),
    "unknown names to check": (
        "check scene.txt --free kd,colour",
        f"free parameters must be among {FREE}, got colour",
    ),
    "bounces below 0 to check": (
        "check scene.txt --bounces -1",
        "--bounces must be at least 0, got -1",
    ),
    "missing scene": (
        "render no.txt -o out.png",
        "no.txt: cannot read the scene: No such file or directory",
    ),
    "a folder for a scene": ("info .", ".: cannot read the scene: Is a directory"),
    "bad scene": (
        "render bad.txt -o out.png",
        "bad.txt:6:9: radius must be greater than 0, got -80",
    ),
    "a picture for a scene": (
        "info cut.png",
        "cut.png:2:1: expected text, got binary data (byte 0x1a)",
    ),
    "no size": (
        "render scene.txt -o out.png --size 32",
        "--size must be WIDTHxHEIGHT in pixels, such as 512x512, got '32'",
    ),
    "size of 0": (
        "render scene.txt -o out.png --size 32x0",
        "--size must be WIDTHxHEIGHT in pixels, such as 512x512, got '32x0'",
    ),
    "negative size": (
        "render scene.txt -o out.png --size 32x-24",
        "--size must be WIDTHxHEIGHT in pixels, such as 512x512, got '32x-24'",
    ),
    "huge size": (
        "render scene.txt -o out.png --size 99999x99999",
        "--size must be at most 268435456 pixels in all, got 99999x99999",
    ),
    "unknown ending": (
        "render scene.txt -o out.gif",
        "out.gif: expected a picture file (.exr, .hdr, .png, .ppm, .tif, .tiff, .jpg, .jpeg), "
        "got '.gif'",
    ),
    "bits that do not go": (
        "render scene.txt -o out.jpg --bits 16",
        "out.jpg: .jpg files have 8 bits, got 16",
    ),
    "no folder for the picture": (
        "render scene.txt -o no/out.png",
        "no/out.png: there is no folder no to write to",
    ),
    "a folder for a picture": (
        "render scene.txt -o folder.png",
        "folder.png: expected a file to write, this is a folder",
    ),
    "negative bounces": (
        "render scene.txt -o out.png --bounces -1",
        "--bounces must be at least 0, got -1",
    ),
    "no samples": (
        "render scene.txt -o out.png --samples 0",
        "--samples must be at least 1, got 0",
    ),
    "missing target": (
        "fit scene.txt no.png -o out.txt",
        "no.png: there is no such picture",
    ),
    "cut target": (
        "fit scene.txt cut.png -o out.txt",
        "cut.png: cannot be read as a picture: the file ends within a chunk",
    ),
    "words for a target": (
        "fit scene.txt words.png -o out.txt",
        "words.png: cannot be read as a picture: Not a PNG file",
    ),
    "no folder for the fit": (
        "fit scene.txt target.exr -o no/out.txt",
        "no/out.txt: there is no folder no to write to",
    ),
    "a folder for a fit": (
        "fit scene.txt target.exr -o folder.png",
        "folder.png: expected a file to write, this is a folder",
    ),
    "a device for a fit": (
        "fit scene.txt target.exr -o /dev/null",
        "/dev/null: expected a file to write, this is a device or a pipe",
    ),
    "a file for the report": (
        "fit scene.txt target.exr -o out.txt --report scene.txt",
        "scene.txt: expected a name that ends in .html, or a folder",
    ),
    "unknown name": (
        "fit scene.txt target.exr -o out.txt --free ks,colour",
        f"free parameters must be among {FREE}, got colour",
    ),
    "no name": (
        "fit scene.txt target.exr -o out.txt --free ,",
        f"free parameters must be among {FREE}, got none",
    ),
    "a sphere too many": (
        "fit scene.txt target.exr -o out.txt --free color:1-3,kd",
        "--free color: the scene has spheres 1 to 2, got 3",
    ),
    "sphere 0": (
        "fit scene.txt target.exr -o out.txt --free kd:0",
        "--free: expected NAME or NAME:1,3-5, objects counted from 1, got 'kd:0'",
    ),
    "numbers without a name": (
        "fit scene.txt target.exr -o out.txt --free kd,2",
        "--free: expected NAME or NAME:1,3-5, objects counted from 1, got '2'",
    ),
    "a name without numbers": (
        "fit scene.txt target.exr -o out.txt --free kd:",
        "--free: expected NAME or NAME:1,3-5, objects counted from 1, got 'kd:'",
    ),
    "numbers backwards": (
        "fit scene.txt target.exr -o out.txt --free kd:2-1",
        "--free: expected NAME or NAME:1,3-5, objects counted from 1, got 'kd:2-1'",
    ),
    "a name twice": (
        "fit scene.txt target.exr -o out.txt --free kd,kd:1",
        "--free must name kd once",
    ),
    "a tie of different starts": (
        "fit scene.txt target.exr -o out.txt --free kd --tie kd",
        "kd of spheres 1, 2 is tied and must start alike, got 0.6, 0.5",
    ),
    "bounds without numbers": (
        "fit scene.txt target.exr -o out.txt --free kd --bounds kd",
        "--bounds: expected NAME:X..Y, got 'kd'",
    ),
    "bounds around nothing": (
        "fit scene.txt target.exr -o out.txt --free kd --bounds kd:.9...1",
        "bounds of kd: the lower, 0.9, is above the upper, 0.1",
    ),
    "bounds of what is not free": (
        "fit scene.txt target.exr -o out.txt --free kd --bounds ka:0..1",
        "bounds must name free parameters, got ka",
    ),
    "a start out of bounds": (
        "fit scene.txt target.exr -o out.txt --free kd --bounds kd:..0.55",
        "kd of sphere 1 starts at 0.6, outside of its bounds -inf to 0.55",
    ),
    "priors without noise": (
        "fit scene.txt target.exr -o out.txt --free kd --priors kd:.5+-.1",
        "priors need noise, against which their sigma counts: say noise too",
    ),
    "a prior without a deviation": (
        "fit scene.txt target.exr -o out.txt --free kd --noise 1 --priors kd:.5+-0",
        "priors of kd: sigma must be greater than 0, got 0",
    ),
    "a brightness of two channels": (
        "fit scene.txt target.exr -o out.txt --brightest .9,.8",
        "--brightest must be one number, or three with commas, got '.9,.8'",
    ),
    "a brightness in words": (
        "fit scene.txt target.exr -o out.txt --brightest white",
        "--brightest must be one number, or three with commas, got 'white'",
    ),
    "no steps": (
        "fit scene.txt target.exr -o out.txt --max-steps 0",
        "--max-steps must be at least 1, got 0",
    ),
    "negative bounces of a fit": (
        "fit scene.txt target.exr -o out.txt --bounces -2",
        "--bounces must be at least 0, got -2",
    ),
    "no .pov": (
        "convert scene.txt out.obj",
        "out.obj: expected a file that ends in .pov or .txt or .xml",
    ),
    "no folder for the .pov": (
        "convert scene.txt no/out.pov",
        "no/out.pov: there is no folder no to write to",
    ),
    "bounces for POV-Ray": (
        "convert scene.txt out.pov --bounces 256",
        "bounces must be in 0..255 for POV-Ray, got 256",
    ),
    "a file for the demo": (
        "demo -o scene.txt",
        "scene.txt: expected a folder to write to, this is a file",
    ),
    "a file for the cache": (
        "render scene.txt -o out.png --cache scene.txt",
        "scene.txt: expected a folder to write to, this is a file",
    ),
    "a cache in a file": (
        "fit scene.txt target.exr -o out.txt --cache scene.txt/cache",
        "scene.txt/cache: expected a folder to write to, scene.txt is a file",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_and_status_2_and_nothing_is_written(mistake, spheretrace, folder):
    words, message = MISTAKES[mistake]
    Path("folder.png").mkdir()
    before = files(folder)
    assert spheretrace(*words.split(" ")) == (2, "", f"spheretrace: {message}\n")
    assert files(folder) == before
    assert [f.name for f in folder.iterdir() if f.is_dir()] == ["folder.png"]


@pytest.mark.parametrize(
    "words",
    [
        "",
        "draw scene.txt",
        "render scene.txt",
        "render scene.txt -o out.png --highlight flat",
        "render scene.txt -o out.png --bounces many",
        "render scene.txt -o out.png --colour srgb",
        "fit scene.txt -o out.txt",
    ],
)
def test_words_that_no_option_knows_exit_with_2(words, spheretrace, folder):
    before = files(folder)
    status, out, err = spheretrace(*words.split())
    assert (status, out) == (2, "") and "spheretrace" in err
    assert files(folder) == before


def test_a_cache_that_cannot_be_written_to_is_a_mistake(spheretrace, folder, monkeypatch):
    Path("kept").mkdir()
    monkeypatch.setattr(os, "access", lambda path, mode: "kept" not in str(path))
    message = "spheretrace: kept: the folder kept cannot be written to\n"
    assert spheretrace(*RENDER, "--cache", "kept") == (2, "", message)


# --- the cache ------------------------------------------------------------------------------------

COUNTING = """
import collections, jax
from spheretrace_jax.cli.main import main

counts = collections.Counter()
jax.monitoring.register_event_listener(lambda event, **_: counts.update([event]))
try:
    main()
finally:
    print(*(counts["/jax/compilation_cache/" + name] for name in ("cache_hits", "cache_misses")))
"""


def test_a_second_process_with_the_cache_compiles_nothing(folder):
    def counted(output: str) -> tuple[int, int]:
        words = ("render", "scene.txt", "-o", output, "--size", "32x24", "--cache", "new/cache")
        result = python("-c", COUNTING, *words, folder=folder)
        assert (result.returncode, result.stderr) == (0, "")
        hits, misses = result.stdout.splitlines()[-1].split()
        return int(hits), int(misses)

    hits, misses = counted("first.exr")
    assert misses > 0
    kept = files(folder / "new" / "cache").keys()
    assert counted("second.exr") == (hits + misses, 0)
    assert files(folder / "new" / "cache").keys() == kept
    np.testing.assert_array_equal(st.read_image("second.exr"), st.read_image("first.exr"))


# --- help, and what is loaded ---------------------------------------------------------------------

HELP = {
    "": ["render", "fit", "info", "convert", "demo", "find the world that a picture shows"],
    "render": [
        *("SCENE", "-o IMAGE", "--size WxH", "width and height in pixels", "512x512"),
        *("--highlight {phong,blinn}", "--bounces N", "reflections and transmissions at most"),
        *("--samples K", "mean of K x K parts", "--dtype {float32,float64}", "--bits B"),
        *("--colorspace {auto,linear,srgb}", "how to code the file's numbers", "png, ppm"),
        *("--cache DIR", "keep compiled programs", "--no-cache"),
    ],
    "fit": [
        *("SCENE", "TARGET", "-o FITTED.txt", "--free NAMES", "color, ka, kd, ks, exponent"),
        *("light_position", "--highlight {phong,blinn}", "--max-steps N", "--report DIR|FILE.html"),
        *(
            "pictures and a table",
            "--dtype",
            "when it is interrupted",
            "Exit status 1",
            "--cache DIR",
        ),
        *("--noise X|photo", "--tolerance X", "not to be used"),
    ],
    "check": ["SCENE", "--size WxH", "--free NAMES", "the worst pixels and why"],
    "info": ["SCENE", "what is left out and why"],
    "convert": ["SCENE", "OUT", "POV-Ray", "Mitsuba", "NFF"],
    "demo": ["-o DIR", "the folder to write to", "POV-Ray", "from a wrong start", "--cache DIR"],
    "cache": ["--clear", "delete the compiled programs", "where compiled programs are kept"],
}


@pytest.mark.parametrize("command", HELP)
def test_help_teaches(command, spheretrace, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    status, out, err = spheretrace(*command.split(), "--help")
    assert (status, err) == (0, "")
    plain = " ".join(re.sub("[│╭╮╰╯─]", " ", out).split())
    assert [words for words in HELP[command] if words not in plain] == []


def test_the_program_runs_as_a_module(tmp_path):
    result = python("-m", "spheretrace_jax.cli", "--help", folder=tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.startswith("usage: spheretrace ")


def test_the_package_loads_without_the_libraries_of_the_host(tmp_path):
    program = "import sys, spheretrace_jax; print(*sys.modules)"
    result = python("-c", program, folder=tmp_path)
    loaded = set(result.stdout.split())
    assert "spheretrace_jax.rendering.render" in loaded, result.stderr
    assert not loaded & {"OpenImageIO", "matplotlib", "rich", "tyro"}
