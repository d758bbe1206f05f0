"""Compiled closures are shared by models that differ in effects, within a thread."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ident.fit import identify
from ident.motion import complete
from identification import motion_log, plant, robot


def test_models_that_differ_in_effects_share_what_is_compiled():
    mechanism = robot("four_bar")
    viscous, coulomb = (mechanism.with_effect(kind) for kind in ("viscous", "coulomb"))
    assert viscous.kinematics is coulomb.kinematics
    with ThreadPoolExecutor(1) as pool:  # it writes to memory of its own
        other = pool.submit(lambda: mechanism.with_effect("drag").kinematics).result()
    assert other is not viscous.kinematics


def test_threads_with_models_of_one_machine_get_results_of_their_own():
    mechanism = robot("four_bar")
    log = plant(mechanism.with_effect("viscous"), motion_log("four_bar", 200.0, 4.0), seed=1).log

    def numbers(kind):
        model = mechanism.with_effect(kind)
        return identify(model, complete(model, log)).estimate.x

    kinds = ("viscous", "coulomb") * 2
    expected = [numbers(kind) for kind in kinds]
    for _ in range(3):
        with ThreadPoolExecutor(4) as pool:
            for x, y in zip(pool.map(numbers, kinds), expected, strict=True):
                np.testing.assert_allclose(x, y, rtol=1e-9, atol=1e-12)
