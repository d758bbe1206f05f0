"""A checkpoint knows effects that were made in memory."""

import hashlib

import casadi as ca
import pytest

from ident import user_effect
from ident.streams.portions import _feed


def key(thing):
    found = hashlib.sha256()
    _feed(found, thing)
    return found.hexdigest()


def made(function):
    return user_effect("wobble", function)(("elbow",))


def by_factor(k):
    return lambda s: {"A": ca.sin(k * s.q)}


def test_the_same_function_has_the_same_digest():
    assert key(made(by_factor(2))) == key(made(by_factor(2)))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (lambda s: {"A": ca.sin(s.q)}, lambda s: {"A": ca.cos(s.q)}),
        (lambda s: {"A": ca.sin(2 * s.q)}, lambda s: {"A": ca.sin(3 * s.q)}),
        (by_factor(1), by_factor(2)),
    ],
)
def test_another_function_has_another_digest(one, other):
    assert key(made(one)) != key(made(other))
