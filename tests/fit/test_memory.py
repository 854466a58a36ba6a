"""The memory that a fit of a large picture takes."""

import subprocess
import sys
import warnings

import numpy as np
import pytest
from helpers.scenes import nine_spheres

import spheretrace_jax as st
from spheretrace_jax.fit.problem import memory
from spheretrace_jax.scene.settings import render_settings

SCENE = nine_spheres((100.0, 500, 800))


def said(width: int, height: int, *, antialias: int = 0, shrink: int = 1, pictures: int = 1) -> str:
    settings = [render_settings(SCENE.with_antialias(antialias), width, height)] * pictures
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        memory.warn_of_memory(settings, 4, shrink)
    assert all(w.category is st.PictureWarning for w in caught)
    return "\n".join(str(w.message) for w in caught)


def test_12_million_pixels_are_named_with_their_memory_and_a_smaller_fit():
    fit = "a fit of 12.2 million pixels takes about"
    assert said(4032, 3024) == f"{fit} 3.8 GB of memory, with shrink=2 (--shrink 2) about 0.94 GB"
    assert said(4032, 3024, antialias=1).startswith(f"{fit} 7.6 GB of memory, with shrink=3 ")
    assert said(4031, 3024) == f"{fit} 3.8 GB of memory"  # no side divides both
    assert "shrink=6 (--shrink 6)" in said(4032, 3024, shrink=3)
    assert (
        not said(1024, 1024) and not said(1512, 2016) and "of 12.2 " in said(1512, 2016, pictures=4)
    )


def test_a_fit_says_it_before_it_takes_memory(monkeypatch):
    monkeypatch.setattr(memory, "_MUCH", 1e3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(st.PictureWarning, match=r"0\.0 million pixels .*, with shrink=8 "):
            st.fit(SCENE, np.full((8, 8, 3), 0.5), bounces=0)


MEASURE = """
import resource, sys, warnings, numpy as np, spheretrace_jax as st
from spheretrace_jax.fit.problem.memory import memory
from spheretrace_jax.study.benchmarks.wrong_start import wrong_start
scene = st.load_scene(sys.argv[1], "float32").with_antialias(int(sys.argv[2]))
peak = lambda: 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
def fit(side):
    target = np.asarray(st.render(scene, width=side, height=side, bounces=0))
    return st.fit(wrong_start(scene), target, bounces=0, max_steps=2)
fit(32)
before = peak()
found = fit(1600)
print((peak() - before) / memory(found.problem.settings[0], 4))
"""


@pytest.mark.slow
@pytest.mark.parametrize("antialias", [0, 1])
def test_what_is_said_is_what_a_fit_takes(antialias, tmp_path):
    st.save_scene(tmp_path / "scene.txt", SCENE)
    words = [sys.executable, "-c", MEASURE, tmp_path / "scene.txt", str(antialias)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert 0.6 < float(done.stdout) < 1.6
