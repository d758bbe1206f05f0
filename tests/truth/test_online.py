"""`Online`: the numbers of a batch, of weighted least squares, and of planted values."""

import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from streaming import HOW, blocks, given, raw_rows, samples

import ident
from helpers import ROBOTS
from ident import FitError, Log, LogError, Noise, Online
from ident.equations.rows import Rows, Scene, largest_transmission
from ident.equations.unknowns import Columns
from ident.information.chance import covariance
from ident.streams.stream import INTERVALS, Accumulator
from identification import motion_log, plant, robot

FRICTION = ("viscous", "coulomb")


def made(name, effects=(), rate=200.0, seconds=2.0, noise=0.01, seed=0):
    mechanism = robot(name)
    for effect in effects:
        mechanism = mechanism.with_effect(effect)
    said = [Noise("tau", noise, relative=True)] if noise else []
    return plant(mechanism, motion_log(name, rate, seconds), noise=said, seed=seed)


def fed(online, parts):
    for part in parts:
        online.update(part)
    return online.snapshot()


def beta(found):
    return np.array([value.value for value in found.base_parameters])


def assert_same(found, fit, tolerance=1e-9):
    """Base parameters by what they do: each times the norm of its column."""
    assert [v.name for v in found.base_parameters] == [v.name for v in fit.base_parameters]
    norm = fit.estimate.triangle.column_norms()[fit.estimate.base.independent]
    off = np.abs((beta(found) - beta(fit)) * norm)
    assert off.max() <= tolerance * np.abs(beta(fit) * norm).max()


# --- the same as a batch -----------------------------------------------------------------------


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("cutoff", [None, 12.0], ids=["all rows", "filtered"])
@pytest.mark.parametrize("name", ["arm", "four_bar", "five_bar", "slider_crank"])
def test_parameters_of_identify(name, cutoff, how):
    case = made(name, FRICTION)
    motion = ident.complete(case.mechanism, case.log, cutoff=cutoff)
    fit = ident.identify(case.mechanism, motion, estimator="least-squares")
    found = fed(Online(case.mechanism, like=motion), given(case.log, how))
    assert_same(found, fit)
    assert found.rank == fit.rank
    for joint, error in fit.train.items():
        assert found.errors[joint].rms == pytest.approx(error.rms, rel=1e-7)
    for value in found.parameters:
        if value.identifiable:
            assert value.value == pytest.approx(fit[value.name].value, rel=1e-6, abs=1e-9)


def test_after_every_hundred_samples():
    case = made("arm", FRICTION)
    motion = ident.complete(case.mechanism, case.log, cutoff=None)
    online = Online(case.mechanism, like=motion)
    for number, sample in enumerate(samples(case.log), start=1):
        online.update(sample)
        if number % 100 == 0:
            part = case.log.t <= sample["t"]
            log = Log.from_arrays(
                "part", case.log.t[part], {k: x[part] for k, x in case.log.columns.items()}
            )
            so_far = ident.complete(case.mechanism, log, cutoff=None, smoothing=None)
            e = replace(so_far.experiments[0], still=motion.experiments[0].still)
            so_far = replace(so_far, experiments=(e,))
            fit = ident.identify(case.mechanism, so_far, estimator="least-squares")
            assert_same(online.snapshot(), fit)


def test_errors_are_those_of_the_batch_on_the_same_cells():
    """The jackknife over the intervals that the stream kept, and about that over a batch's own."""
    case = made("arm", FRICTION, seconds=6.0)
    motion = ident.complete(case.mechanism, case.log, cutoff=None)
    fit = ident.identify(case.mechanism, motion, estimator="least-squares")
    online = Online(case.mechanism, like=motion)
    found = fed(online, given(case.log, "blocks"))
    cells = online._accumulator.information(len(fit.estimate.x))
    assert len(cells.times) <= INTERVALS + 1
    expected = np.sqrt(np.diag(covariance(cells, fit.estimate)))
    own = np.array([value.stderr for value in found.base_parameters])
    np.testing.assert_allclose(own, expected, rtol=1e-6)
    ratio = own / np.array([value.stderr for value in fit.base_parameters])
    assert 0.7 < np.median(ratio) < 1.4


def test_planted_values_lie_within_their_errors():
    off = []
    for seed in range(4):
        case = made("arm", FRICTION, seconds=4.0, noise=0.02, seed=seed)
        motion = ident.complete(case.mechanism, case.log, cutoff=None)
        found = fed(Online(case.mechanism, like=motion), given(case.log, "blocks"))
        off += [
            (value.value - case.values[value.name]) / value.stderr
            for value in found.parameters
            if value.identifiable and value.name in case.values
        ]
    assert np.mean(np.abs(off) < 2) > 0.85
    assert np.abs(off).max() < 6


def test_shapes_are_held_where_a_fit_has_them():
    case = made("arm", ("viscous", "coulomb", "stribeck:elbow"), noise=0.003)
    motion = ident.complete(case.mechanism, case.log, cutoff=None)
    fit = ident.identify(case.mechanism, motion, estimator="least-squares")
    online = Online(case.mechanism, like=fit)
    found = fed(online, given(case.log, "blocks"))
    held = online._stream.mechanism.effects[-1].values["vs"]
    assert held == pytest.approx(fit["stribeck.elbow.vs"].value, rel=1e-9)
    assert found["stribeck.elbow.Fs"].value == pytest.approx(
        fit["stribeck.elbow.Fs"].value, rel=0.02
    )


def test_a_mechanism_of_which_everything_is_known_has_errors_only():
    case = made("slider_crank")
    known = replace(case.mechanism, unknown=())
    motion = ident.complete(known, case.log, cutoff=None)
    found = fed(Online(known, like=motion), given(case.log, "blocks"))
    assert found.parameters == ()
    fit = ident.identify(known, motion)
    assert found.errors["theta"].rms == pytest.approx(fit.train["theta"].rms, rel=1e-9)
    assert found.multipliers is not None
    assert (found.multipliers.stderr == 0).all()


# --- forgetting --------------------------------------------------------------------------------


@pytest.mark.parametrize("how", HOW)
def test_forgetting_is_weighted_least_squares(how):
    """exp(−age/T) on every squared equation, solved by LAPACK on all rows."""
    case = made("slider_crank", ["coulomb:theta"], seconds=3.0, noise=0.01)
    motion = ident.complete(case.mechanism, case.log, cutoff=None)
    T = 0.8
    found = fed(Online(case.mechanism, like=motion, forget=T), given(case.log, how))
    columns, e = Columns.of(case.mechanism), motion.experiments[0]
    rows = raw_rows(Scene.of(case.mechanism, columns, e), slice(0, len(e)), largest_transmission(e))
    told = rows.informed[:, 0]
    w = np.exp((rows.t - rows.t[-1]) / (2 * T))[told]
    x = np.linalg.lstsq(rows.A[told, 0] * w[:, None], rows.b[told, 0] * w, rcond=None)[0]
    assert found.rank == len(columns)
    np.testing.assert_allclose(beta(found), x, rtol=1e-9)
    assert found.rows == pytest.approx(np.exp((rows.t - rows.t[-1]) / T).sum(), rel=0.02)


def test_old_equations_are_forgotten_and_nothing_else():
    """A payload's mass is picked up midway: with forgetting, the new value; without, a mixture."""
    light, heavy = (made("arm", seconds=4.0, seed=seed) for seed in (1, 2))
    t = np.concatenate([light.log.t, light.log.t + 4.0])
    columns = {k: np.concatenate([x, heavy.log.columns[k]]) for k, x in light.log.columns.items()}
    log = Log.from_arrays("changed.csv", t, columns)
    motion = ident.complete(light.mechanism, light.log, cutoff=None)
    name = "hand.my"
    forgetful = fed(Online(light.mechanism, like=motion, forget=0.4), given(log, "blocks"))
    assert abs(forgetful[name].value - heavy.values[name]) < 4 * forgetful[name].stderr
    before, after = light.values[name], heavy.values[name]
    mixed = fed(Online(light.mechanism, like=motion), given(log, "blocks"))[name].value
    assert min(before, after) < mixed < max(before, after)
    assert abs(mixed - after) > 0.2 * abs(before - after)


def standing(log, seconds):
    """The log, and then its last position for some time."""
    dt = log.t[1] - log.t[0]
    more = np.arange(1, round(seconds / dt) + 1) * dt
    columns = {}
    for name, x in log.columns.items():
        rest = np.full(len(more), 0.0 if name[0] in "va" else x[-1])
        columns[name] = np.concatenate([x, rest])
    return Log.from_arrays("rest.csv", np.concatenate([log.t, log.t[-1] + more]), columns)


@pytest.mark.parametrize("effects", [FRICTION, ()], ids=["nothing informs", "gravity informs"])
def test_standing_still_for_long_forgets_nothing_wrongly(effects):
    """Two hundred time constants at rest: values stay, errors grow, and moving tells again."""
    case = made("arm", effects, seconds=3.0)
    motion = ident.complete(case.mechanism, case.log, cutoff=None)
    log = standing(case.log, 20.0)
    online = Online(case.mechanism, like=motion, forget=0.1)
    moving = fed(online, given(case.log, "blocks"))
    found = [moving]
    for start in range(len(case.log.t), len(log.t), 400):
        part = slice(start, start + 400)
        block = {"t": log.t[part], **{k: x[part] for k, x in log.columns.items()}}
        found.append(fed(online, [block]))
    last = found[-1]
    known = {v.name: v for v in moving.parameters if v.identifiable}
    assert len(last.held) > 0.5 * len(known)
    for name in last.held:
        value = last[name]
        assert np.isfinite(value.value)
        errors = [each[name].stderr for each in found if name in each.held]
        assert (np.diff(errors) > 0).all()
        if name in known:
            assert value.stderr > 1e3 * known[name].stderr
            assert abs(value.value - known[name].value) < value.stderr
    again = motion_log("arm", 200.0, 3.0)
    moved = plant(case.mechanism, again, noise=[Noise("tau", 0.01, relative=True)], seed=0)
    after = fed(online, [{"t": moved.log.t + 30.0, **moved.log.columns}])
    assert not after.held
    np.testing.assert_allclose(beta(after), beta(moving), atol=0.2 * np.abs(beta(moving)).max())


# --- multipliers -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["four_bar", "five_bar", "slider_crank", "pendulum"])
def test_multipliers_of_a_batch(name):
    case = made(name, FRICTION, noise=0.0)
    motion = ident.complete(case.mechanism, case.log, cutoff=None)
    fit = ident.identify(case.mechanism, motion, estimator="least-squares")
    online = Online(case.mechanism, like=motion, latency=0.05)
    log = list(samples(case.log))
    fed(online, log[:300])
    online.snapshot()
    parts = []
    for sample in log[300:]:
        online.update(sample)
        parts += [online.multipliers] if online.multipliers is not None else []
    online.snapshot()
    parts += [online.multipliers] if online.multipliers is not None else []
    t, known = fit.multipliers[0]
    found = np.concatenate([part.values for part in parts])
    np.testing.assert_array_equal(np.concatenate([part.t for part in parts]), t[300:])
    scale = np.nanmax(np.abs(known))
    np.testing.assert_allclose(found, known[300:], atol=1e-6 * scale)


def test_errors_of_multipliers_cover_the_truth():
    """Noise anew: λ of the planted model lies within two standard errors most of the time."""
    off = []
    for seed in range(8):
        mechanism, log = robot("five_bar"), motion_log("five_bar", 200.0, 3.0)
        clean = plant(mechanism, log, seed=1)
        rng = np.random.default_rng(seed)
        columns = {
            k: x + (0.05 * np.std(x) * rng.normal(size=len(x)) if k.startswith("tau.") else 0.0)
            for k, x in clean.log.columns.items()
        }
        motion = ident.complete(mechanism, clean.log, cutoff=None)
        truth = ident.identify(mechanism, motion, estimator="least-squares").multipliers[0][1]
        online = Online(mechanism, like=motion)
        online.update(Log.from_arrays("noisy.csv", log.t, columns))
        last = online.snapshot().multipliers
        each = (last.values[-1] - truth[-1]) / last.stderr[-1]
        off += list(each[np.isfinite(each)])
    assert len(off) == 16
    assert np.mean(np.abs(off) < 2) > 0.75
    assert np.sqrt(np.mean(np.square(off))) > 0.3


# --- the first seconds -------------------------------------------------------------------------


def test_without_a_log_the_first_seconds_decide_and_count():
    case = made("arm", FRICTION, seconds=4.0)
    online = Online(case.mechanism, warmup=1.5, cutoff=None)
    assert not online.warm
    assert np.isnan(online.lag)
    found = fed(online, given(case.log, "one by one"))
    assert online.warm
    part = case.log.t <= 1.5 + 1e-9
    first = Log.from_arrays(
        "1", case.log.t[part], {k: x[part] for k, x in case.log.columns.items()}
    )
    like = ident.complete(case.mechanism, first, cutoff=None)
    same = fed(Online(case.mechanism, like=like), given(case.log, "one by one"))
    np.testing.assert_allclose(beta(found), beta(same), rtol=1e-8)
    assert found.samples == len(case.log.t)


def test_a_snapshot_ends_the_warm_up():
    case = made("arm", seconds=1.0)
    online = Online(case.mechanism)
    online.update(case.log)
    assert not online.warm
    found = online.snapshot()
    assert online.warm
    assert found.samples == len(case.log.t)


def test_a_rest_before_the_motion_decides_nothing():
    """A stream that begins long before the machine moves, with noise on all channels."""
    case = made("arm", FRICTION, seconds=8.0)
    n, noise = 1460, np.random.default_rng(5)
    columns = {k: x for k, x in case.log.columns.items() if k.startswith(("q.", "tau."))}
    columns = {k: np.append(x[0] + 1e-5 * noise.standard_normal(n), x) for k, x in columns.items()}
    t = np.append(np.arange(n) / 200, case.log.t + n / 200 + 1.0)  # what is between is not logged
    online = Online(case.mechanism, cutoff=12.0)
    found = fed(online, blocks(Log.from_arrays("rest.csv", t, columns), [50]))
    assert any("before the machine moved are left out" in note for note in found.notes)
    assert found.samples == len(t)
    assert found.rank == 30
    for value in found.identified:
        assert abs(value.value - case.values[value.name]) < 6 * value.stderr, value.name


def test_a_clock_in_milliseconds_ends_the_stream_at_once():
    case = made("arm", seconds=6.0)
    online = Online(case.mechanism)
    with pytest.raises(ident.MotionError, match="t is not in seconds"):
        online.update({"t": 1e3 * case.log.t, **case.log.columns})


@pytest.mark.parametrize(("factor", "against", "noted"), [(1.3, True, False), (1.3, False, True),
                                                          (40.0, True, True)])  # fmt: skip
def test_torques_of_another_size_than_a_fit_has_are_no_unit_but_a_load(factor, against, noted):
    mechanism = robot("five_bar")
    log = ident.read_log(ROBOTS / "five_bar" / "run.csv")
    motion = ident.complete(mechanism, log)
    torques = {n: factor * x for n, x in log.columns.items() if n.startswith("tau.")}
    loaded = Log.from_arrays(log.name, log.t, {**log.columns, **torques})
    online = Online(mechanism, like=ident.identify(mechanism, motion) if against else motion)
    online.update(loaded)
    assert any("URDF's bodies need" in note for note in online.finish().notes) == noted


def test_a_named_fault_is_noted_and_standard_errors_hold_it():
    """All torques 40 ms late: friction is off by many standard errors of the scatter."""
    case = made("arm", FRICTION, seconds=10.0)
    names = [name for name in case.log.columns if name.startswith("tau.")]
    late = {n: np.roll(case.log.columns[n], 8)[8:] for n in names}
    rest = {n: x[8:] for n, x in case.log.columns.items()}
    log = Log.from_arrays("late.csv", case.log.t[8:], {**rest, **late})
    online = Online(case.mechanism)
    fed(online, blocks(log, [100]))
    found = online.finish()
    assert any("ms late" in note for note in found.notes)
    for value in found.identified:
        assert abs(value.value - case.values[value.name]) < 3 * value.stderr, value.name


def test_what_is_wrong_with_the_first_seconds_is_said():
    case = made("arm", seconds=1.0)
    with pytest.raises(LogError, match="no sample yet"):
        Online(case.mechanism).snapshot()
    online, good = Online(case.mechanism), list(samples(case.log))
    online.update(good[0])
    with pytest.raises(LogError, match=r"q\.yaw = inf in the sample"):
        online.update(good[1] | {"q.yaw": np.inf})
    with pytest.raises(LogError, match="other columns than those before"):
        online.update(good[1] | {"hue": 1.0})
    with pytest.raises(LogError, match="comes after one at"):
        online.update(good[0])
    with pytest.raises(ident.MotionError, match="no column 't'"):
        online.update({"q.yaw": 1.0})
    online.update(good[1])
    assert online.samples == 2
    torqueless = Online(case.mechanism, warmup=0.01)
    bare = {k: x for k, x in case.log.columns.items() if not k.startswith("tau")}
    with pytest.raises(ident.MotionError, match="tau"):
        torqueless.update({"t": case.log.t, **bare})


@pytest.mark.parametrize(
    "options", [{"forget": 0.0}, {"forget": np.nan}, {"latency": -1.0}, {"warmup": 0.0}]
)
def test_times_that_are_none(options):
    with pytest.raises(FitError, match="valid: a time in seconds"):
        Online(robot("arm"), **options)


def test_effects_that_cannot_be_had():
    with pytest.raises(FitError, match=r"hysteresis:yaw.*leave out"):
        Online(robot("arm").with_effect("hysteresis:yaw"))
    with pytest.raises(FitError, match="needs a motion or a fit"):
        Online(robot("arm"), like="run.csv")


@pytest.mark.parametrize(("column", "value"), [("tau.elbow", 1e20), ("q.elbow", 100.0)])
@pytest.mark.parametrize("warm", [True, False])
def test_an_absurd_sample_turns_no_parameter(column, value, warm):
    case = made("arm", FRICTION, seconds=6.0)
    motion = ident.complete(case.mechanism, case.log, cutoff=12.0)
    odd = case.log.columns[column].copy()
    odd[300] = value
    log = Log.from_arrays("odd.csv", case.log.t, {**case.log.columns, column: odd})
    found = fed(Online(case.mechanism, like=motion if warm else None, cutoff=12.0), [log])
    fit = ident.identify(case.mechanism, motion, estimator="least-squares")
    assert any(f"{column} = {value:.4g}" in note for note in found.notes)
    for value in found.parameters:
        if value.identifiable:
            assert abs(value.value - fit[value.name].value) < 2 * value.stderr
    whole = ident.complete(case.mechanism, log, cutoff=12.0)
    assert any(f"{column} = " in note and "in row 301" in note for note in whole.notes)


# --- memory ------------------------------------------------------------------------------------


@pytest.mark.parametrize("forget", [None, 1.0])
@pytest.mark.parametrize("name", ["slider_crank", "arm"])
def test_memory_does_not_grow(name, forget):
    """Twice as many samples, of a log that repeats itself: as many bytes."""
    case = made(name, FRICTION, seconds=2.0)
    motion = ident.complete(case.mechanism, case.log, cutoff=12.0)
    online = Online(case.mechanism, like=motion, forget=forget)
    sizes = []
    for turn in range(41):
        online.update({"t": case.log.t + turn * 2.02, **case.log.columns})
        if turn in (20, 40):
            online.snapshot()
            sizes.append(len(pickle.dumps(online)))
    assert sizes[1] < 1.2 * sizes[0] + 10_000


def test_a_pickled_stream_goes_on_as_if_nothing_had_been():
    case = made("five_bar", FRICTION)
    motion = ident.complete(case.mechanism, case.log, cutoff=12.0)
    log = list(samples(case.log))
    online = Online(case.mechanism, like=motion)
    for sample in log[:150]:
        online.update(sample)
    copy = pickle.loads(pickle.dumps(online))
    again, found = beta(fed(copy, log[150:])), beta(fed(online, log[150:]))
    np.testing.assert_allclose(again, found, rtol=1e-11)


def test_intervals_stay_few_and_hold_everything():
    rng = np.random.default_rng(0)
    store = Accumulator([np.arange(3)], None, 0.01)
    A, b = rng.normal(size=(20_000, 1, 3)), rng.normal(size=(20_000, 1))
    t, told = np.arange(20_000) * 0.01, rng.random((20_000, 1)) > 0.1
    start = 0
    while start < len(t):
        part = slice(start, start + int(rng.integers(1, 200)))
        some = (x[part] for x in (A, b, b, told, told, 0.0 * told))
        store.absorb(Rows(t[part], np.arange(len(t))[part], *some))
        start = part.stop
        assert len(store.information(3).times) <= 1.5 * INTERVALS + 1
    cells = store.information(3)
    assert sum(cell.triangle.rows for cell in cells) == told.sum()
    assert sum(cell.rest.rows for cell in cells) == (~told).sum()
    whole = cells.totals[0]
    mine = told[:, 0]
    expected = np.linalg.lstsq(A[mine, 0], b[mine, 0], rcond=None)[0]
    np.testing.assert_allclose(np.linalg.solve(whole.R, whole.d), expected, rtol=1e-10)
    assert sum(sum(cell.torque) for cell in cells) == pytest.approx(float((b**2).sum()))
    spans = [cell.span for cell in cells]
    assert all(a[1] < b[0] for a, b in pairwise(spans))


def test_it_prints_itself():
    case = made("slider_crank", noise=0.01)
    motion = ident.complete(case.mechanism, case.log, cutoff=None)
    online = Online(case.mechanism, like=motion, forget=0.5)
    found = fed(online, samples(case.log))
    said = str(found)
    assert "rod.Ixx" in said
    assert "ball.x = " in said
    assert "lag" in said
    assert "\n" not in found.line
    assert "rod.Izz = " in found.line
    with pytest.raises(KeyError, match=r"did you mean 'rod\.Ixx'"):
        found["rod.Ix"]


def test_an_absurd_sample_is_refused_and_of_a_block_only_that_sample():
    folder = ROBOTS / "five_bar"
    mechanism = ident.load(folder).with_effect("viscous")
    log = ident.read_log(folder / "run.csv")
    online = Online(mechanism, like=ident.complete(mechanism, log), latency=0.05)
    for i, part in enumerate(blocks(log, [10])):
        odd = {**part, "q.left": part["q.left"] + np.where(np.arange(len(part["t"])) == 9, 50, 0)}
        if i == 50:
            online.update({name: x[:9] for name, x in odd.items()})
            with pytest.raises(LogError, match=r"q\.left = .* is no measurement"):
                online.update({name: x[9:] for name, x in odd.items()})
            continue
        online.update(odd if i == 51 else part)
    found = online.snapshot()
    assert found.samples == len(log.t) - 2
    assert any("1 samples are left out" in note and "q.left = " in note for note in found.notes)
    assert np.isfinite(found["viscous.left.Fv"].value)
