"""States that corrections move: one that is kept is the one that would be made, and no other."""

import numpy as np
import pytest

from helpers import series
from ident.equations.rows import corrected
from ident.equations.terms import Samples
from ident.equations.unknowns import Point
from ident.log import Log
from ident.mechanism import load
from ident.motion import complete
from ident.motion.state import Store

ARRAYS = ("tau", "usable", "q", "v", "a", "y", "yd", "ydd")
VALUES = ({"offset": 0.01, "d": 0.0}, {"offset": 0.01, "d": 0.02}, {"offset": -0.02, "d": 0.02})


def moved(name, robots):
    """A mechanism whose first drive has an offset and is read late, and one state of it."""
    mechanism = load(robots / name)
    joint = mechanism.driven[0]
    for kind in ("encoder_offset", "position_delay", "torque_gain"):
        mechanism = mechanism.with_effect(f"{kind}:{joint}")
    t, *motion = series(name, rate=100.0)
    columns = {f"{p}.{j}": x[j] for p, x in zip("qva", motion, strict=True) for j in x}
    columns |= {f"tau.{j}": np.sin(t + i) for i, j in enumerate(mechanism.driven)}
    (e,) = complete(mechanism, Log.from_arrays("run.csv", t, columns)).experiments
    return mechanism, e


def at(mechanism, e, **shapes):
    """The corrected state at values of shapes, by the last part of their names."""
    names = [name for effect in mechanism.effects for name in effect.names]
    values = {name: shapes.get(name.rpartition(".")[2], 0.0) for name in names}
    point = Point.prior(mechanism).with_values(values)
    return corrected(Samples(mechanism, e, slice(None), point), None).e


def assert_same(one, other):
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for mine, theirs in zip(one.loop or (), other.loop or (), strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("name", ["arm", "four_bar"])
def test_a_kept_state_is_the_one_that_would_be_made(name, robots, monkeypatch):
    mechanism, e = moved(name, robots)
    again = [at(mechanism, e, **shape) for shape in VALUES * 2]
    monkeypatch.setattr(Store, "LIMIT", 0)
    mechanism, fresh = moved(name, robots)
    for shape, state in zip(VALUES * 2, again, strict=True):
        assert_same(state, at(mechanism, fresh, **shape))
    assert not fresh.store._states


def test_it_has_the_torques_and_the_weights_of_rows_at_rest_of_now(robots):
    mechanism, e = moved("arm", robots)
    before = at(mechanism, e, offset=0.01)
    other = e.with_torques(2 * e.tau).with_rest(np.ones(3))
    now = at(mechanism, other, offset=0.01)
    assert now.q is before.q  # kept
    np.testing.assert_array_equal(now.tau, 2 * before.tau)
    np.testing.assert_array_equal(now.rest, np.ones(3))


def test_one_of_other_samples_is_made_anew(robots):
    mechanism, e = moved("arm", robots)
    at(mechanism, e, offset=0.01)
    fewer = e.with_torques(e.tau, e.usable & (e.t > 1.0))
    assert not at(mechanism, fewer, offset=0.01).usable[e.t <= 1.0].any()


def test_the_last_ones_are_kept_and_freed(robots):
    before = Store._used
    mechanism, e = moved("arm", robots)
    for shape in VALUES:
        at(mechanism, e, **shape)
    assert len(e.store._states) == Store.STATES
    assert Store._used == before + sum(state.nbytes for _, state in e.store._states.values())
    del e
    assert Store._used == before
