"""Standard input and output in place of files: the name `-`."""

import io
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import FIT, TEXT, fill, status_of

import spheretrace_jax as st

SIZE = ("--size", "32x24")


@pytest.fixture
def spheretrace(tmp_path, monkeypatch, capfdbinary):
    """Runs the program with some standard input: `(status, stdout, stderr)`."""
    monkeypatch.chdir(tmp_path)
    fill(tmp_path)

    def run(*words: object, given: bytes = b"") -> tuple[int, bytes, str]:
        monkeypatch.setattr(sys, "stdin", types.SimpleNamespace(buffer=io.BytesIO(given)))
        status, (out, err) = status_of(*words), capfdbinary.readouterr()
        return status, out, err.decode()

    return run


@pytest.mark.parametrize(("words", "ending"), [((), "png"), (("--format", "exr"), "exr")])
def test_a_scene_from_standard_input_and_its_picture_to_standard_output(spheretrace, words, ending):
    assert spheretrace("render", "scene.txt", "-o", f"a.{ending}", *SIZE)[0] == 0
    status, out, err = spheretrace("render", "-", "-o", "-", *SIZE, *words, given=TEXT.encode())
    assert status == 0 and err.startswith("-: 32 x 24, ") and err.count("\n") == 1
    Path(f"b.{ending}").write_bytes(out)
    np.testing.assert_array_equal(st.read_image(f"a.{ending}"), st.read_image(f"b.{ending}"))


def test_textures_of_a_scene_from_standard_input_are_in_the_current_folder(spheretrace):
    st.write_image("ball.png", np.full((2, 2, 3), 0.5))
    text = TEXT.replace("8  0 0 0", "8  0 0 1") + "texture ball.png\n"
    assert spheretrace("convert", "-", "out.pov", given=text.encode())[0] == 0
    assert "ball.png" in Path("out.pov").read_text()


@pytest.mark.slow
def test_a_fit_reads_its_picture_and_writes_its_scene(spheretrace):
    words = (*FIT, "--free", "kd,ks", "--colorspace", "linear")
    assert spheretrace(*words)[0] == 0
    through = [word.replace("target.exr", "-").replace("fitted.txt", "-") for word in words]
    status, out, err = spheretrace(*through, given=Path("target.exr").read_bytes())
    assert status == 0 and err.startswith("-: converged")
    Path("piped.txt").write_bytes(out)
    piped, fitted = st.load_scene("piped.txt"), st.load_scene("fitted.txt")
    np.testing.assert_allclose(piped.spheres.kd, fitted.spheres.kd, rtol=1e-9)
    # a scene through a pipe
    again = spheretrace("convert", "-", "-", given=out)
    assert again[0] == 0 and b"light_source" in again[1] and again[2].startswith("-: render it")


def test_mistakes_name_standard_input(spheretrace):
    status, out, err = spheretrace(
        "convert", "-", "-", given=TEXT.replace(" 80 ", " -80 ").encode()
    )
    message = "standard input:6:9: radius must be greater than 0, got -80"
    assert (status, out, err) == (2, b"", f"spheretrace: {message}\n")
    status, out, err = spheretrace("fit", "scene.txt", "-", "-o", "-", given=b"no picture")
    assert (status, out) == (2, b"") and err.startswith("spheretrace: standard input: cannot be")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("fit", "-", "-", "-o", "a.txt"), "only one file can be read from standard input (-)"),
        (("render", "-", "-o", "a.png", "--format", "exr"), "--format is of standard output (-)"),
        (("render", "-", "-o", "-", "--layers"), "layers need an EXR file (.exr), got '.png'"),
        (("render", "-", "-o", "-", "--bits", "32"), ".png files have 8 or 16 bits, got 32"),
    ],
)
def test_what_cannot_be_is_one_line(spheretrace, words, message):
    status, out, err = spheretrace(*words, given=TEXT.encode())
    assert (status, out) == (2, b"") and message in err and err.count("\n") == 1


def test_no_picture_goes_to_a_terminal(spheretrace, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    status, out, err = spheretrace("render", "-", "-o", "-", given=TEXT.encode())
    assert (status, out) == (2, b"") and "standard output is a terminal" in err


def test_version(spheretrace):
    assert spheretrace("--version") == (0, f"spheretrace {st.__version__}\n".encode(), "")
