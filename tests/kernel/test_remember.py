"""What is computed once a logged series: of series that nobody can write to, while they exist."""

import gc

import numpy as np

from ident.log.remember import once_a_series


def counted():
    calls = []

    @once_a_series
    def total(x):
        calls.append(len(x))
        return float(x.sum())

    return total, calls


def frozen(n):
    x = np.arange(float(n))
    x.setflags(write=False)
    return x


def test_a_series_that_nobody_writes_to_is_asked_once():
    total, calls = counted()
    x = frozen(5)
    assert total(x) == total(x) == 10.0
    assert calls == [5]
    assert total(x[1:3]) == total(x[1:3]) == 3.0
    assert calls == [5, 2]
    assert total(x[::2]) == 6.0
    assert total(x.view("int64")) != 10.0


def test_one_that_may_change_is_asked_each_time():
    total, calls = counted()
    x = np.arange(5.0)
    early = x[:]  # stays writable
    assert total(x) == 10.0
    x[0] = 1.0
    assert total(x) == 11.0
    x.setflags(write=False)
    assert total(early) == 11.0
    early[0] = 2.0
    assert total(early) == 12.0
    assert len(calls) == 4


def test_a_series_is_forgotten_with_its_end():
    total, calls = counted()
    for n in range(3, 40):  # places in memory are used again
        x = frozen(n)
        assert total(x) == n * (n - 1) / 2
        del x
    gc.collect()
    assert len(calls) == 37
