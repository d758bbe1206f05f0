"""Logs as they come: gaps, empty cells, rates of their own, jitter, wrong units and signs."""

import re

import numpy as np
import pinocchio as pin
import polars as pl
import pytest

from helpers import Truth, series, write_mechanism
from ident.errors import LogError, MechanismError, MotionError
from ident.log import Log, read_log
from ident.log.log import entry_for
from ident.mechanism import load
from ident.mechanism.load import absolute
from ident.motion import complete
from ident.motion.signals import without_repeats

DEGREES = 180 / np.pi
TAU = {
    "four_bar": ("crank",),
    "five_bar": ("left", "right"),
    "slider_crank": ("theta", "s"),
    "arm": ("yaw", "shoulder", "elbow", "wrist"),
}


def drive(name, at=None, **options):
    """(t, columns of the driven joints with torques, exact q, v, a) of a robot's motion."""
    t, q, v, a = series(name, **options)
    columns = {f"tau.{joint}": np.cos(2 * t) for joint in TAU[name]}
    for prefix, x in zip("qva", (q, v, a), strict=True):
        columns |= {f"{prefix}.{joint}": values for joint, values in x.items()}
    return t, columns


def positions(columns):
    return {k: x for k, x in columns.items() if k.startswith(("q.", "tau."))}


def run(robots, name, t, columns, **options):
    mechanism = load(robots / name)
    return mechanism, complete(mechanism, Log.from_arrays("run.csv", t, columns), **options)


def exact_at(name, t, t0, columns):
    """Every column at the times t, from its dense truth."""
    return {k: np.interp(t, t0, x) for k, x in columns.items()}


def left_out_at_ends(motion):
    """How far from the ends of every run samples were left out [s], as the notes say."""
    said = [re.search(r"samples within ([\d.]+) ms of where splines end", n) for n in motion.notes]
    return 1e-3 * max((float(match[1]) for match in said if match), default=0.0)


@pytest.mark.parametrize("noise", [0.0, 1e-4])
@pytest.mark.parametrize("name", ["four_bar", "five_bar", "arm"])
def test_a_gap_in_time_is_left_out_and_both_sides_are_kept(name, noise, robots):
    t, columns = drive(name)
    rng = np.random.default_rng(0)
    columns = {k: x + rng.normal(scale=noise, size=len(t)) for k, x in columns.items()}
    keep = (t < 1.5) | (t > 2.1)
    logged = {k: x[keep] for k, x in positions(columns).items()}
    mechanism, motion = run(robots, name, t[keep], logged)
    (e,) = motion.experiments
    assert len(e) == len(t)
    assert not (e.usable & ~keep).any()
    assert len(list(e.segments())) == 2
    assert any("no sample near" in note for note in motion.notes)
    ends, lost = left_out_at_ends(motion), int((keep & ~e.usable).sum())
    assert bool(noise) == bool(lost)  # clean positions are interpolated, up to the ends
    for run_ in (t < 1.5, t > 2.1):
        inside = (t > t[run_][0] + 1.001 * ends) & (t < t[run_][-1] - 1.001 * ends)
        assert e.usable[inside].all()
        assert np.ptp(t[run_ & e.usable]) > 1.2
    if noise:
        assert any(f"run.csv: {lost} samples within" in note for note in motion.notes)
    for joint in TAU[name]:
        at = mechanism.joint_index[joint]
        for found, prefix, most in ((e.y, "q", 1e-3), (e.yd, "v", 0.05), (e.ydd, "a", 0.5)):
            exact = drive(name)[1][f"{prefix}.{joint}"]
            inner = e.usable & (np.abs(t - 1.8) > 0.35) & (t > 0.1) & (t < t[-1] - 0.1)
            off = np.sqrt(np.mean((found[inner, at] - exact[inner]) ** 2))
            assert off < (most if noise else 1e-3 * most) * np.std(exact), (joint, prefix)


@pytest.mark.parametrize("channels", ["q", "qva"])
@pytest.mark.parametrize("length", [3, 60])
def test_runs_of_empty_cells(channels, length, robots):
    # a few are interpolated, many are left out; both are said
    t, columns = drive("four_bar")
    truth = dict(columns)
    columns = {
        k: x for k, x in columns.items() if k.startswith(("tau", *(f"{c}." for c in channels)))
    }
    for key in [k for k in columns if not k.startswith("tau")]:
        columns[key] = np.where(
            (np.arange(len(t)) >= 300) & (np.arange(len(t)) < 300 + length), np.nan, columns[key]
        )
    mechanism, motion = run(robots, "four_bar", t, columns)
    (e,) = motion.experiments
    assert (~e.usable).sum() == (0 if length == 3 else length)
    (note,) = (x for x in motion.notes if f"empty in {length} of {len(t)} rows" in x)
    assert (
        "q.crank is empty" in note
        if len(channels) == 1
        else "q.crank, v.crank and a.crank are empty" in note
    )
    inner = e.usable & (t > 0.1) & (t < t[-1] - 0.1)
    at = mechanism.joint_index["crank"]
    for found, prefix, most in ((e.y, "q", 1e-8), (e.yd, "v", 1e-5), (e.ydd, "a", 2e-3)):
        off = found[inner, at] - truth[f"{prefix}.crank"][inner]
        assert np.abs(off).max() < most, prefix


def test_channels_may_have_rates_of_their_own(robots):
    # torques at 200 Hz, positions at 100 Hz in the same file
    t, columns = drive("five_bar")
    exact = dict(columns)
    columns = positions(columns)
    for key in ("q.left", "q.right"):
        columns[key] = np.where(np.arange(len(t)) % 2 == 0, columns[key], np.nan)
    mechanism, motion = run(robots, "five_bar", t, columns)
    (e,) = motion.experiments
    assert e.usable[:-1].all()
    inner = slice(20, -20)
    at = mechanism.joint_index["left"]
    assert np.abs(e.ydd[inner, at] - exact["a.left"][inner]).max() < 1e-3 * np.std(exact["a.left"])


def test_noisy_positions_coarser_than_the_clock(robots):
    # q at 50 Hz with noise beside torques at 500 Hz
    t, columns = drive("arm", rate=500.0)
    exact, columns = dict(columns), positions(columns)
    rng = np.random.default_rng(0)
    for joint in TAU["arm"]:
        q = columns[f"q.{joint}"] + rng.normal(scale=1e-4, size=len(t))
        columns[f"q.{joint}"] = np.where(np.arange(len(t)) % 10 == 0, q, np.nan)
    mechanism, motion = run(robots, "arm", t, columns)
    (e,) = motion.experiments
    inner = slice(100, -100)
    for joint in TAU["arm"]:
        at = mechanism.joint_index[joint]
        for found, prefix, most in ((e.y, "q", 1e-3), (e.yd, "v", 0.01), (e.ydd, "a", 0.1)):
            off = found[inner, at] - exact[f"{prefix}.{joint}"][inner]
            assert np.sqrt(np.mean(off**2)) < most * np.std(exact[f"{prefix}.{joint}"]), joint


def test_short_runs_between_gaps_are_left_out(robots):
    t, columns = drive("arm")
    keep = (t < 1.5) | ((t > 2.0) & (t < 2.03)) | (t > 2.5)
    _, motion = run(robots, "arm", t[keep], {k: x[keep] for k, x in positions(columns).items()})
    assert len(list(motion.experiments[0].segments())) == 2
    assert any("short runs between gaps" in note for note in motion.notes)


def test_columns_that_never_meet_are_refused(robots):
    t, columns = drive("arm")
    columns = positions(columns)
    columns["q.yaw"] = np.where(t < 2, columns["q.yaw"], np.nan)
    columns["q.elbow"] = np.where(t > 2, columns["q.elbow"], np.nan)
    with pytest.raises(MotionError, match="no run of"):
        run(robots, "arm", t, columns)


def test_only_what_is_cut_is_a_gap_and_the_rest_is_jitter(robots):
    t, columns = drive("arm", rate=100.0, seconds=12.0)
    keep = np.random.default_rng(0).uniform(size=len(t)) > 0.6  # two cells in five are there
    keep &= (t < 6) | (t > 9)
    logged = {k: x[keep] for k, x in positions(columns).items()}
    _, motion = run(robots, "arm", t[keep], logged)
    cut = [note for note in motion.notes if "no sample near" in note]
    assert len(cut) == 1
    assert re.search(r"a gap of 3(\.\d+)? s \(first at t = [56](\.\d+)? s\)", cut[0])
    assert any("time stamps are uneven" in note for note in motion.notes)


def test_a_log_of_even_runs_has_gaps_and_no_jitter(robots):
    t, columns = drive("arm", rate=100.0, seconds=12.0)
    keep = (t < 4) | ((t > 5) & (t < 7)) | (t > 8)
    logged = {k: x[keep] for k, x in positions(columns).items()}
    _, motion = run(robots, "arm", t[keep], logged)
    assert any("2 gaps of up to 1" in note for note in motion.notes)
    assert not any("uneven" in note for note in motion.notes)


@pytest.mark.parametrize("share", [0.05, 0.3])
@pytest.mark.parametrize("name", ["four_bar", "arm"])
def test_uneven_time_stamps(name, share, robots):
    # stamps that are late by up to `share` of a step, each with the position at that very time
    t, _ = drive(name)
    rng = np.random.default_rng(5)
    late = t + share / 200 * rng.uniform(size=len(t))
    late[0], late[-1] = t[0], t[-1]
    dense_t, dense = drive(name, rate=20000.0, seconds=4.0)
    logged = positions({k: np.interp(late, dense_t, x) for k, x in dense.items()})
    mechanism, motion = run(robots, name, late, logged)
    (e,) = motion.experiments
    assert any("time stamps are uneven" in note for note in motion.notes)
    assert np.ptp(np.diff(e.t)) < 1e-9
    inner = slice(40, -40)
    for joint in TAU[name]:
        at = mechanism.joint_index[joint]
        for found, prefix, most in ((e.y, "q", 1e-5), (e.yd, "v", 1e-3), (e.ydd, "a", 2e-2)):
            exact = np.interp(e.t, dense_t, dense[f"{prefix}.{joint}"])
            off = np.sqrt(np.mean((found[inner, at] - exact[inner]) ** 2))
            assert off < most * np.std(exact), (joint, prefix)


# --- refused, with the remedy -------------------------------------------------------------------

WRONG = {
    "q in degrees": ({"q": DEGREES}, "degrees"),
    "v in degrees a second": ({"v": DEGREES}, "degrees"),
    "v in rpm": ({"v": 30 / np.pi}, "revolutions a minute"),
    "no position is in rpm": (
        {"q": 30 / np.pi},
        "if all joints are off by the same factor, give t one",
    ),
    "v of the wrong sign": ({"v": -1.0}, "scale = -1"),
    "a of the wrong sign": ({"a": -1.0}, "scale = -1"),
    "v in revolutions a second": ({"v": 1 / (2 * np.pi)}, "revolutions"),
    "q of the wrong sign": ({"q": -1.0}, "scale = -1"),
    "a in degrees": ({"a": DEGREES}, "degrees"),
}


@pytest.mark.parametrize("case", WRONG)
def test_units_and_signs_that_contradict_each_other(case, robots):
    factors, says = WRONG[case]
    t, columns = drive("arm")
    for prefix, factor in factors.items():
        columns[f"{prefix}.elbow"] = factor * columns[f"{prefix}.elbow"]
    with pytest.raises(MotionError, match=r"elbow.*disagree") as caught:
        run(robots, "arm", t, columns)
    assert says in str(caught.value)
    assert "[log]" in str(caught.value)


def test_degrees_beyond_the_joints_limits(robots):
    t, columns = drive("arm")
    columns = positions(columns)
    for joint in TAU["arm"]:
        columns[f"q.{joint}"] = DEGREES * columns[f"q.{joint}"]
    with pytest.raises(MotionError, match=r"beyond the joint's limit.*looks like degrees.*scale"):
        run(robots, "arm", t, columns)


def test_a_column_of_no_joint_is_said(robots):
    t, columns = drive("arm")
    _, motion = run(robots, "arm", t, columns | {"q.elbwo": t, "temperature.elbow": 20 + t})
    assert any(
        "'q.elbwo' names no joint" in n and "did you mean 'elbow'" in n for n in motion.notes
    )
    np.testing.assert_allclose(motion.experiments[0].extra["temperature.elbow"], 20 + t)


def test_the_robots_own_names_are_mapped(tmp_path, robots):
    t, columns = drive("arm")
    toml = (robots / "arm" / "mechanism.toml").read_text().split("\n", 2)[2]
    urdf = (robots / "arm" / "arm.urdf").read_text()
    toml += '\n[log]\n"tau.yaw" = "amps"\n'
    toml += f'"q.yaw" = {{ column = "base_deg", scale = {np.pi / 180!r}, offset = 0.1 }}'
    mechanism = load(write_mechanism(tmp_path, urdf, toml))
    q, tau = columns.pop("q.yaw"), columns.pop("tau.yaw")
    columns |= {"base_deg": DEGREES * (q - 0.1), "amps": tau}
    log = Log.from_arrays("run.csv", t, columns)
    log.write(tmp_path / "run.csv")
    for given in (log, tmp_path / "run.csv", str(tmp_path / "run.csv")):
        (e,) = complete(mechanism, given).experiments
        at = mechanism.joint_index["yaw"]
        np.testing.assert_allclose(e.y[:, at], q, atol=1e-12)
        np.testing.assert_allclose(e.tau[:, at], tau, atol=1e-12)


def renamed_arm(tmp_path, robots, toml):
    """The arm with more of a mechanism.toml, and its log under other names."""
    t, columns = drive("arm")
    own = (robots / "arm" / "mechanism.toml").read_text().split("\n", 2)[2]
    urdf = (robots / "arm" / "arm.urdf").read_text()
    names = {"q": "pos_{}", "tau": "effort_{}", "v": "vel_{}", "a": "acc_{}"}
    given = {}
    for name, x in columns.items():
        channel, _, joint = name.partition(".")
        given[names[channel].format(joint)] = DEGREES * x if channel == "q" else x
    mechanism = load(write_mechanism(tmp_path, urdf, own + toml))
    return mechanism, Log.from_arrays("run.csv", t, given), columns


def test_one_entry_maps_the_columns_of_all_joints(tmp_path, robots):
    toml = f"""
[log]
"q.*" = {{ column = "pos_*", scale = {1 / DEGREES!r} }}
"tau.*" = "effort_*"
"tau.yaw" = {{ column = "effort_yaw", scale = 2 }}
"""
    mechanism, log, columns = renamed_arm(tmp_path, robots, toml)
    log.write(tmp_path / "run.csv")
    for given in (log, tmp_path / "run.csv"):
        (e,) = complete(mechanism, given).experiments
        for joint, at in mechanism.joint_index.items():
            np.testing.assert_allclose(e.y[:, at], columns[f"q.{joint}"], atol=1e-9)
            factor = 2 if joint == "yaw" else 1
            np.testing.assert_allclose(e.tau[:, at], factor * columns[f"tau.{joint}"], atol=1e-9)


def test_an_underscore_stands_for_the_dot(robots, tmp_path):
    mechanism = load(robots / "arm")
    log = read_log(robots / "arm" / "run.csv")
    log.polars().rename(lambda name: name.replace(".", "_")).write_csv(tmp_path / "run.csv")
    (e,), (known,) = (
        complete(mechanism, x).experiments for x in (tmp_path / "run.csv", robots / "arm/run.csv")
    )
    np.testing.assert_array_equal(e.tau, known.tau)
    both = log.polars().with_columns(q_elbow=pl.lit(3.0))
    both.write_csv(tmp_path / "both.csv")  # the column with the dot is the position
    (e,) = complete(mechanism, tmp_path / "both.csv").experiments
    np.testing.assert_array_equal(e.y, known.y)


@pytest.mark.parametrize("times", [1.7, 3.0, 10 / 3])
def test_rows_that_are_all_repeated_are_one_sample_each(robots, times):
    log = read_log(robots / "arm" / "run.csv")
    at = (np.arange(int(times * len(log.t))) / times).astype(int)
    t = np.arange(len(at)) * (log.t[1] - log.t[0]) / times
    repeated = Log.from_arrays("repeated", t, {name: x[at] for name, x in log.columns.items()})
    kept = without_repeats(repeated)
    np.testing.assert_array_equal(
        kept.columns["tau.elbow"], log.columns["tau.elbow"][: len(kept.t)]
    )
    assert len(kept.t) >= len(log.t) - 1
    assert f"{times:.3g} equal ones" in kept.repairs[-1]
    assert without_repeats(log) is log
    motion = complete(load(robots / "arm"), repeated)
    assert any("each row is repeated" in note for note in motion.notes)


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ('"q.*" = "pos"', "one \\* of each"),
        ('"q.x*" = "pos_*"', "is the name of no joint"),
        ('"q.*" = "pos_*"\n"q.y*" = "pos_y*"', "also made by"),
    ],
)
def test_an_entry_for_no_joint_is_refused(tmp_path, robots, entry, says):
    with pytest.raises(MechanismError, match=says):
        renamed_arm(tmp_path, robots, f"\n[log]\n{entry}\n")


def test_an_entry_that_finds_no_column_is_refused(tmp_path, robots):
    mechanism, log, _ = renamed_arm(tmp_path, robots, '\n[log]\n"q.*" = "position_*"\n')
    log.write(tmp_path / "run.csv")
    with pytest.raises(LogError, match=r"'q\.\*' in mechanism.toml finds no column of any joint"):
        complete(mechanism, tmp_path / "run.csv")


def test_a_log_without_mapped_positions_gets_the_entry_to_write(tmp_path, robots):
    mechanism, log, _ = renamed_arm(tmp_path, robots, "")
    with pytest.raises(MotionError) as caught:
        complete(mechanism, log)
    said = str(caught.value)
    assert '[log] "q.*" = "pos_*" and "v.*" = "vel_*" and "tau.*" = "effort_*"' in said
    assert "columns that are not used: effort_yaw, " in said


def test_one_message_has_the_entries_of_all_channels_that_a_log_without_t_lacks(tmp_path, robots):
    mechanism, log, _ = renamed_arm(tmp_path, robots, "")
    log.polars().rename({"t": "stamp"}).write_csv(tmp_path / "run.csv")
    with pytest.raises(LogError) as caught:
        complete(mechanism, tmp_path / "run.csv")
    entries = ('"t" = "stamp"', '"q.*" = "pos_*"', '"v.*" = "vel_*"', '"tau.*" = "effort_*"')
    assert f"[log] {' and '.join(entries)}" in str(caught.value)


def test_joints_and_columns_may_share_their_numbers_alone():
    joints, columns = ["arm_joint_1", "arm_joint_2"], ["torq_1", "pos_1", "torq_2", "pos_2"]
    assert entry_for("q", joints, columns) == '"q.arm_joint_*" = "pos_*"'
    assert entry_for("tau", joints, columns) == '"tau.arm_joint_*" = "torq_*"'
    assert entry_for("q", ["elbow"], columns) == ""


@pytest.mark.parametrize("named", ["{}", "j_{}_"])
@pytest.mark.parametrize("first", [0, 1])
def test_columns_numbered_from_another_number_than_joints_are_no_pattern(named, first):
    """The column of a joint's own number is that of its neighbour."""
    joints = [f"j_{i + 1 - first}" for i in range(3)]
    columns = [word + named.format(i + first) for word in ("pos", "tau") for i in range(3)]
    for signal, word in (("q", "pos"), ("tau", "tau")):
        a, b = (word + named.format(i + first) for i in (0, 2))
        pairs = f'"{signal}.{joints[0]}" = "{a}", … "{signal}.{joints[2]}" = "{b}"'
        assert entry_for(signal, joints, columns) == pairs


def test_columns_in_another_spelling_are_found():
    assert entry_for("tau", ["elbow"], ["foo", "tau.elbw"]) == '"tau.elbow" = "tau.elbw"'
    assert entry_for("q", ["yaw", "elbow"], ["Q.Yaw", "Q.Elbow"]).startswith('"q.yaw" = "Q.Yaw"')
    assert entry_for("q", ["joint_1"], ["q.joint_7"]) == entry_for("q", ["beta"], ["q.theta"]) == ""


def test_which_columns_are_whose_is_open_where_there_are_more_from_number_0_on():
    joints, columns = ["j_1", "j_2"], ["q0", "q1", "q2"]
    assert entry_for("q", joints, columns) == ""
    assert entry_for("q", joints, [*columns[1:], "q3"]) == '"q.j_*" = "q*"'


# --- several logs, cut-off, wrenches ------------------------------------------------------------


def test_several_logs_stay_apart(robots):
    mechanism = load(robots / "four_bar")
    made = [drive("four_bar", rate=rate, seconds=s) for rate, s in ((200.0, 2.0), (125.0, 3.0))]
    logs = [Log.from_arrays(f"{i}.csv", t, positions(c)) for i, (t, c) in enumerate(made)]
    together = complete(mechanism, logs)
    assert [e.name for e in together.experiments] == ["0.csv", "1.csv"]
    assert together.samples == sum(len(t) for t, _ in made)
    for log, e in zip(logs, together.experiments, strict=True):
        (alone,) = complete(mechanism, log, cutoff=together.band.cutoff).experiments
        for field in ("q", "v", "a", "yd", "tau"):
            np.testing.assert_allclose(getattr(e, field), getattr(alone, field), atol=1e-9)
    assert [row[:2] for row in together.rows[1:]] == [
        [e.name, str(len(e))] for e in together.experiments
    ]
    assert all(row[0] in str(together) for row in together.rows)
    assert all(note in together._repr_html_() for note in ("0.csv: q.crank", "1.csv: q.crank"))


def test_a_joint_must_be_logged_in_every_log(robots):
    mechanism = load(robots / "five_bar")
    t, columns = drive("five_bar")
    one = Log.from_arrays("one.csv", t, positions(columns))
    less = {k: x for k, x in positions(columns).items() if k != "q.right"}
    with pytest.raises(MotionError, match="determine only 1") as caught:
        complete(mechanism, [one, Log.from_arrays("two.csv", t, less)])
    assert "two.csv" in str(caught.value)


def test_the_cutoff_is_chosen_given_or_none(robots):
    t, columns = drive("arm")
    rng = np.random.default_rng(2)
    clean = positions(columns)
    noisy = {k: x + rng.normal(scale=1e-3, size=len(t)) for k, x in clean.items()}
    assert run(robots, "arm", t, columns)[1].band.cutoff is None
    automatic = run(robots, "arm", t, noisy)[1].band
    assert 0.75 <= automatic.motion <= 2.0  # harmonics up to 5 of 4 s: 1.25 Hz
    noisier = automatic.cutoff
    assert 2 * automatic.motion <= noisier < 5 * automatic.motion  # accelerations are noisy
    quieter = {k: x + rng.normal(scale=1e-5, size=len(t)) for k, x in clean.items()}
    automatic = run(robots, "arm", t, quieter)[1].band
    assert noisier < automatic.cutoff <= 5 * automatic.motion
    assert run(robots, "arm", t, noisy, cutoff=17.0)[1].band.cutoff == 17.0
    assert run(robots, "arm", t, noisy, cutoff=None)[1].band.cutoff is None
    for wrong in (-1.0, 0.0, 100.0, np.nan, "often"):
        with pytest.raises(MotionError, match="cut-off"):
            run(robots, "arm", t, noisy, cutoff=wrong)


@pytest.mark.parametrize("name", ["arm", "four_bar"])
def test_external_wrenches_are_in_the_frames_own_axes(name, robots):
    link = {"arm": "hand", "four_bar": "coupler_link"}[name]
    t, columns = drive(name, seconds=0.5)
    rng = np.random.default_rng(1)
    wrench = rng.normal(size=(len(t), 6))
    for i, part in enumerate(("fx", "fy", "fz", "mx", "my", "mz")):
        columns[f"wrench.{link}.{part}"] = wrench[:, i]
    _, motion = run(robots, name, t, columns)
    (e,) = motion.experiments
    raw = Truth(name).model
    data = raw.createData()
    frame = raw.frames[raw.getFrameId(link, pin.FrameType.BODY)]
    for k in (0, 50, 99):
        forces = pin.StdVec_Force([pin.Force.Zero() for _ in range(raw.njoints)])
        forces[frame.parentJoint] = frame.placement.act(pin.Force(wrench[k]))
        loaded = pin.rnea(raw, data, e.q[k], e.v[k], e.a[k], forces).copy()
        free = pin.rnea(raw, data, e.q[k], e.v[k], e.a[k]).copy()
        np.testing.assert_allclose(e.wrench[k], free - loaded, atol=1e-12)


def test_a_wrench_on_a_link_whose_joint_has_its_name(tmp_path):
    urdf = """<robot name="r"><link name="base"/><link name="tool"/>
<joint name="tool" type="prismatic">
<parent link="base"/><child link="tool"/><axis xyz="0 0 1"/>
<limit effort="1" velocity="1"/></joint></robot>"""
    mechanism = load(write_mechanism(tmp_path, urdf))
    t = np.arange(100) / 100
    columns = {"q.tool": np.sin(t), "tau.tool": t, "wrench.tool.fz": t}
    (e,) = complete(mechanism, Log.from_arrays("run.csv", t, columns)).experiments
    np.testing.assert_allclose(e.wrench[:, 0], t)


def test_a_wrench_on_a_free_body(robots):
    t, columns = drive("four_bar", seconds=0.5)
    columns["wrench.coupler_link.fx"] = np.sin(9 * t)
    joint = load(robots / "four_bar")
    log = Log.from_arrays("run.csv", t, columns)
    one, other = (complete(m, log).experiments[0] for m in (joint, absolute(joint)))
    np.testing.assert_allclose(
        *(np.einsum("ni,ni->n", e.wrench, e.v) for e in (one, other)), atol=1e-12
    )


@pytest.mark.parametrize(
    ("column", "says"), [("wrench.hand.force", "fx"), ("wrench.hnad.fx", "did you mean 'hand'")]
)
def test_wrong_wrench_columns(column, says, robots):
    t, columns = drive("arm")
    with pytest.raises(MotionError) as caught:
        run(robots, "arm", t, columns | {column: t})
    assert says in str(caught.value)


def test_a_real_log_with_jittering_stamps(shared_data):
    folder = shared_data / "dfki_double_pendulum"
    mechanism = load(folder / "double_pendulum_A0.urdf")
    from ident.log import Column, read_log

    mapping = {"t": Column("time")}
    for i, joint in enumerate(mechanism.driven, start=1):
        mapping |= {
            f"q.{joint}": Column(f"pos_meas{i}"),
            f"v.{joint}": Column(f"vel_meas{i}"),
            f"tau.{joint}": Column(f"tau_meas{i}"),
        }
    motion = complete(mechanism, read_log(folder / "A0_swingup_11.csv", mapping))
    (e,) = motion.experiments
    assert any("uneven" in note for note in motion.notes)
    assert motion.band.cutoff is not None
    assert np.isfinite(e.ydd).all()
    inner = e.usable & (np.arange(len(e)) > 50) & (np.arange(len(e)) < len(e) - 50)
    for i in range(2):
        rise = np.gradient(e.y[:, i], e.t)
        assert np.sqrt(np.mean((rise - e.yd[:, i])[inner] ** 2)) < 0.01 * np.std(e.yd[:, i])


# --- torques at the limit of their channel -------------------------------------------------------


def saturated(robots, **options):
    t, columns = drive("arm", **options)
    x = columns["tau.elbow"] + 1e-3 * np.random.default_rng(0).normal(size=len(t))
    limit = np.quantile(np.abs(x), 0.8)
    columns["tau.elbow"] = np.clip(x, -limit, limit)
    return t, columns


def test_torques_at_the_limit_of_their_channel_are_left_out(robots):
    t, columns = saturated(robots)
    _, motion = run(robots, "arm", t, positions(columns))
    (said,) = [note for note in motion.notes if "stays at an extreme" in note]
    assert "tau.elbow" in said
    assert "left out" in said
    e = motion.experiments[0]
    clipped = np.abs(np.interp(e.t, t, columns["tau.elbow"])) == np.abs(columns["tau.elbow"]).max()
    assert clipped.any()
    assert (e.usable & clipped).sum() < 0.1 * clipped.sum()  # short runs are interpolated
    assert e.usable.sum() > 0.5 * len(t)


def test_a_held_torque_is_that_of_a_joint_at_rest(robots):
    """No limit is what holds a joint, and half of all samples are too many to be a limit."""
    t, columns = saturated(robots)
    top = np.abs(columns["tau.elbow"]) == np.abs(columns["tau.elbow"]).max()
    for x in "va":
        columns[f"{x}.elbow"] = np.zeros_like(t)
    columns["q.elbow"] = np.full_like(t, 1.0)
    assert top.any()
    _, motion = run(robots, "arm", t, columns)
    assert not any("stays at an extreme" in note for note in motion.notes)
    t, columns = saturated(robots)
    columns["tau.elbow"] = np.where(np.sin(5 * t) > -0.5, 1.0, np.cos(3 * t) * 0.9)
    _, motion = run(robots, "arm", t, positions(columns))
    assert not any("stays at an extreme" in note for note in motion.notes)


def test_a_channel_of_few_samples_is_refused(robots):
    t, columns = drive("arm")
    columns = positions(columns)
    columns["q.elbow"] = np.where(
        np.arange(len(t)) % (len(t) // 4) == 0, columns["q.elbow"], np.nan
    )
    with pytest.raises(MotionError, match=r"q\.elbow has \d samples.*valid: 12 or more"):
        run(robots, "arm", t, columns)
