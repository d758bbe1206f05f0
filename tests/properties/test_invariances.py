"""Laws that a fit obeys whatever the machine and the log: drawn by Hypothesis."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lxml import etree

sys.path.insert(0, str(Path(__file__).parent))

from bases import NAMES, Base, base
from mutants import urdf_of

import ident
from helpers import J, tree_urdf, write_mechanism
from ident import Fit, Log, Mechanism
from ident.log import Column
from identification import plant

FEW = settings(
    max_examples=4, deadline=None, derandomize=True, database=None,
    suppress_health_check=list(HealthCheck),
)  # fmt: skip
ROUNDING = 1e-6  # standard errors, for what is the same arithmetic in another order
machines = st.sampled_from(NAMES)


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("bases")


def identified(own: Base, log: Log | list[Log], mechanism: Mechanism | None = None) -> Fit:
    """As the base was: its knots and its filter, which a law must not change."""
    mechanism = mechanism or own.mechanism
    motion = own.fit.motion
    smooth = motion.experiments[0].smooth
    return ident.identify(
        mechanism,
        ident.complete(
            mechanism,
            log,
            cutoff=motion.band.cutoff,
            smoothing=smooth.spacing if smooth else "auto",
        ),
        estimator="least-squares",
    )


def reference(own: Base) -> Fit:
    return identified(own, own.log)


def same(fit: Fit, other: Fit, times: float = ROUNDING, factor: float = 1.0) -> None:
    """Values within so many standard errors; those of `fit` over a factor."""
    assert [value.name for value in fit.base_parameters] == [v.name for v in other.base_parameters]
    for a, b in zip(fit.base_parameters, other.base_parameters, strict=True):
        assert abs(a.value / factor - b.value) <= times * b.stderr + 1e-9 * abs(b.value)


def with_columns(log: Log, change) -> Log:
    return Log.from_arrays(log.name, log.t, {k: change(k, x) for k, x in log.columns.items()})


@FEW
@given(name=machines, exponent=st.floats(-2, 2))
def test_torques_in_another_unit_scale_all_parameters(place, tmp_path_factory, name, exponent):
    own, factor = base(name, place), 10.0**exponent
    folder = tmp_path_factory.mktemp("scaled") / name
    shutil.copytree(own.folder, folder)
    urdf = etree.parse(urdf_of(folder))
    for element in [*urdf.iter("mass"), *urdf.iter("inertia")]:
        for key, value in element.attrib.items():
            element.set(key, repr(factor * float(value)))
    urdf.write(urdf_of(folder))
    log = with_columns(own.log, lambda k, x: x * factor if k[:2] in ("ta", "wr") else x)
    same(identified(own, log, ident.load(folder)), reference(own), 1e-3, factor)


@FEW
@given(name=machines, shift=st.floats(-1e3, 1e5))
def test_time_may_begin_anywhere(place, name, shift):
    own, log = base(name, place), base(name, place).log
    later = Log.from_arrays(log.name, log.t + shift, log.columns)
    same(identified(own, later), reference(own), 1e-3)  # stamps of large times are rounded


@FEW
@given(name=machines, random=st.randoms(use_true_random=False))
def test_the_order_of_columns_is_none(place, name, random):
    own, log = base(name, place), base(name, place).log
    names = list(log.columns)
    random.shuffle(names)
    same(
        identified(own, Log.from_arrays(log.name, log.t, {k: log.columns[k] for k in names})),
        reference(own),
    )


@FEW
@given(name=machines, data=st.data())
def test_channels_under_other_names_units_and_zeros(place, name, data):
    own, log = base(name, place), base(name, place).log
    columns, mapping = {}, {}
    for k, (channel, x) in enumerate(log.columns.items()):
        scale = data.draw(st.sampled_from((1.0, -1.0, 1e-3, 57.29577951308232)))
        offset = data.draw(st.floats(-2, 2))
        columns[f"channel {k}"] = (x - offset) / scale
        mapping[channel] = Column(f"channel {k}", scale, offset)
    mechanism = replace(own.mechanism, columns=mapping)
    other = Log.from_arrays(log.name, log.t, columns)
    same(identified(own, other, mechanism), reference(own), 1e-4)


@FEW
@given(name=machines, text=st.text("abcÅ漢 _-", min_size=1, max_size=8))
def test_columns_that_name_nothing_change_nothing(place, name, text):
    own, log = base(name, place), base(name, place).log
    more = {**log.columns, f"x{text}y": np.sin(log.t)}
    same(identified(own, Log.from_arrays(log.name, log.t, more)), reference(own))


@FEW
@given(name=machines, share=st.floats(0.3, 0.7))
def test_a_log_in_two_parts_gives_the_same(place, name, share):
    own, log = base(name, place), base(name, place).log
    k = int(share * len(log.t))
    parts = [
        Log.from_arrays(f"{i}.csv", log.t[part], {c: x[part] for c, x in log.columns.items()})
        for i, part in enumerate((slice(None, k), slice(k, None)))
    ]
    same(identified(own, parts), reference(own), 6.0)


@FEW
@given(name=machines, first=st.integers(40, 330), count=st.integers(1, 30))
def test_rows_that_are_dropped_cost_their_information_only(place, name, first, count):
    own, log = base(name, place), base(name, place).log
    keep = np.ones(len(log.t), dtype=bool)
    keep[first : first + count] = False
    cut = Log.from_arrays(log.name, log.t[keep], {c: x[keep] for c, x in log.columns.items()})
    same(identified(own, cut), reference(own), 6.0)


@FEW
@given(seed=st.integers(0, 10**6), joints=st.integers(1, 3), rate=st.floats(60, 800))
def test_any_chain_without_noise_is_found_exactly(tmp_path_factory, seed, joints, rate):
    random = np.random.default_rng(seed)
    kinds = random.choice(["revolute", "prismatic", "continuous"], joints)
    names = [f"j{i}" for i in range(joints)]
    chain = [
        J(name, str(kind), "0 0 1" if i % 2 else "0 1 0", names[i - 1] if i else "")
        for i, (name, kind) in enumerate(zip(names, kinds, strict=True))
    ]
    folder = write_mechanism(tmp_path_factory.mktemp("chain"), tree_urdf(chain, seed))
    mechanism = ident.load(folder).with_effect("viscous")
    t = np.arange(0.0, 4.0, 1 / rate)
    columns: dict[str, np.ndarray] = {}
    for name in names:
        w = 2 * np.pi * random.uniform(0.3, 1.0, 3)
        phase, size = random.uniform(0, 6, 3), random.uniform(0.2, 0.6, 3)
        for k, c in enumerate("qva"):
            terms = size * w**k * np.sin(np.outer(t, w) + phase + 0.5 * np.pi * k)
            columns[f"{c}.{name}"] = terms.sum(axis=1)
    planted = plant(mechanism, Log.from_arrays("chain.csv", t, columns), seed=seed)
    fit = planted.fit()
    off = fit.estimate.solution.beta - planted.base(fit)
    size = np.abs(planted.base(fit)).max()
    assert np.abs(off).max() < 1e-6 * max(size, 1.0)
