"""When the best suspect is a name."""

from types import SimpleNamespace

import pytest

from ident.streams.suspects import Naming


@pytest.mark.parametrize(
    ("worth", "surplus", "explained", "sound"),
    [
        (100.0, 1.0, 0.95, True),
        (100.0, 1.0, 0.65, False),  # little is left, yet a third of what is beyond noise
        (100.0, 9.0, 0.95, False),  # what is left is no noise
        (100.0, 9.0, 0.9999, True),  # of a large change a thousandth is no second cause
        (5.0, 1.0, 0.95, False),  # would have raised no alarm by itself
    ],
)
def test_a_name_explains_most_and_leaves_noise(worth, surplus, explained, sound):
    best = SimpleNamespace(worth=worth)
    assert Naming((best,), (), surplus, explained, 1.0, least=11.0).sound == sound


def test_nothing_is_no_name():
    assert not Naming((), (), 0.0, 1.0, 1.0, least=11.0).sound
