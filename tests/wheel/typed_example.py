# pyright: strict
"""States the types that a type checker sees of the installed package; `make dist` checks them."""

from typing import assert_type

import spheretrace_jax as st

scene = st.load_scene("data/nine_spheres.txt")
assert_type(scene, st.Scene)
assert_type(scene.spheres, st.Spheres)
assert_type(scene.lights, st.Lights)
assert_type(scene.camera, st.Camera)
assert_type(scene.with_antialias(0), st.Scene)
assert_type(st.needs(scene), st.Needs)

picture = st.render(scene, width=32, height=32)
found = st.fit(scene, picture)
assert_type(found, st.Fit)
assert_type(found.scene, st.Scene)
assert_type(found.converged, bool)
