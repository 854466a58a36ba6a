from helpers.scenes import SCENES, nine_spheres

import spheretrace_jax as st
from spheretrace_jax.study.benchmarks.feature_cost import feature_costs, operations


def test_what_is_left_out_would_cost_something_and_nothing_else_is_listed():
    scene = nine_spheres((100.0, 500, 800))  # nothing is in the shadow of this light
    costs = feature_costs(scene)
    needs = st.needs(scene)
    assert {"shadows", "transmission", "planes", "checkers"} <= set(costs)
    assert not {"highlights", "reflection", "colors"} & set(costs)
    assert costs["shadows"] > 0.3 and all(cost > -0.05 for cost in costs.values())
    assert all(not getattr(needs, name) for name in costs)


def test_the_count_is_that_of_the_scene_without_covered_edges():
    scene = SCENES["diffuse"]
    counts = [operations(scene.with_antialias(k), st.needs(scene)) for k in (0, 1)]
    assert counts[0] == counts[1] > 24**2
