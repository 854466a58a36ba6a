"""Pictures whose numbers were coded otherwise are named."""

import numpy as np
import pytest
from helpers.wrong_models import START, TRUTH, ambient_gradient, drawn

import spheretrace_jax as st
from spheretrace_jax.base.srgb import code_srgb, srgb


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"), [(code_srgb, "sRGB-encoded"), (srgb, "linear, not decoded from sRGB")]
)
def test_is_named(change, words):
    picture = np.clip(drawn(TRUTH), 0, 1)
    picture = picture + 0.002 * np.random.default_rng(0).standard_normal(picture.shape)
    target = np.clip(change(np.clip(picture, 0, 1)), 0, 1)
    found = st.fit(START, target, bounces=0)
    assert found.trust.grade != "exact" and found.trust.other_numbers == words
    assert f"if its numbers are taken as {words}" in str(found.trust)


def test_other_faults_are_not():
    found = st.fit(START, ambient_gradient((500.0, 400, 700)), bounces=0)
    assert found.trust.grade != "exact" and found.trust.other_numbers is None
    right = st.fit(START, drawn(TRUTH), bounces=0)
    assert right.trust.grade == "exact" and right.trust.other_numbers is None
