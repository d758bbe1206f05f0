"""Smooth columns from a few samples: filtered rows are those of all samples, or all are taken."""

import numpy as np
import pytest

import ident
from helpers import J, tree_urdf, write_mechanism
from ident.equations.filter import Decimator, multiplied, products
from ident.equations.rows import Scene, rows, smooth_step
from ident.equations.thinning import Thinning
from ident.equations.unknowns import Columns

RATE, CUTOFF = 500.0, 4.0


@pytest.mark.parametrize("length", [2000, 2007, 2013])
def test_weights_filter_polynomials_and_slow_waves_like_all_taps(length):
    decimator = Decimator.of(CUTOFF, RATE)
    t = np.linspace(-1, 1, length)
    x = np.stack([t**9 - t**4 + 1, np.sin(2 * np.pi * CUTOFF / RATE * np.arange(length))], axis=1)
    at = np.arange(decimator.half, length - decimator.half, decimator.factor)
    thinning = Thinning(decimator, 7, length)
    found = multiplied(thinning.products(at), x[thinning.nodes])
    right = multiplied(products(decimator.taps, at), x)
    assert np.abs(found[:, 0] - right[:, 0]).max() < 1e-12  # also at the ends of the run
    assert np.abs(found[:, 1] - right[:, 1]).max() < 1e-7


def moving(tmp_path, line: float, noise: float = 0.0):
    """An arm of two joints, in one of which a line of so many rad/s² stands at 40 × the cut-off."""
    joints = [J("a", axis="0 1 0"), J("b", axis="0 1 0", parent="a")]
    folder = write_mechanism(tmp_path, tree_urdf(joints))
    mechanism = ident.load(folder).with_effect("viscous").with_effect("coulomb")
    t = np.arange(6000) / RATE
    w, high = 2 * np.pi * np.array([0.31, 0.83]), 2 * np.pi * 40 * CUTOFF
    columns = {}
    for i, name in enumerate(mechanism.driven):
        size = line / high**2 * (i == 1)
        q = np.sin(w[i] * t) + size * np.sin(high * t)
        v = w[i] * np.cos(w[i] * t) + size * high * np.cos(high * t)
        a = -(w[i] ** 2) * np.sin(w[i] * t) - size * high**2 * np.sin(high * t)
        columns |= {f"q.{name}": q, f"v.{name}": v, f"a.{name}": a, f"tau.{name}": a + np.sign(v)}
    log = ident.Log.from_arrays("line", t, columns)
    return mechanism, ident.complete(mechanism, log, cutoff=CUTOFF, smoothing=None)


def at_full_rate(scene: Scene) -> np.ndarray:
    """A of all rows, with nothing thinned."""
    decimator, found = Decimator.of(CUTOFF, scene.e.rate), []
    for run in scene.e.segments():
        terms = scene.terms(run)
        n = len(terms.A)
        at = np.arange(decimator.half, n - decimator.half, decimator.factor)
        blocks = products(decimator.taps, at)
        found.append(
            multiplied(blocks, terms.A.reshape(n, -1)).reshape(len(at), *terms.A.shape[1:])
        )
    return np.concatenate(found)


@pytest.mark.parametrize(("line", "thinned"), [(0.0, True), (3.0, False), (1e-3, False)])
def test_rows_are_those_of_all_samples(tmp_path, line, thinned):
    mechanism, motion = moving(tmp_path, line)
    (e,) = motion.experiments
    scene = Scene.of(mechanism, Columns.of(mechanism), e, None, CUTOFF)
    assert (smooth_step(scene, CUTOFF) > 1) == thinned
    found = np.concatenate([piece.A for piece in rows(scene, CUTOFF)])
    right = at_full_rate(scene)
    size = np.sqrt((right**2).mean(axis=0))
    off = np.sqrt(((found - right) ** 2).mean(axis=0))
    assert (off <= 1e-8 * np.maximum(size, 1e-6 * size.max())).all()


def test_a_short_run_takes_all_samples(tmp_path):
    mechanism, motion = moving(tmp_path, 0.0)
    (e,) = motion.experiments
    short = e.at_samples(slice(0, 1200))
    scene = Scene.of(mechanism, Columns.of(mechanism), short, None, CUTOFF)
    assert smooth_step(scene, CUTOFF) == 1
