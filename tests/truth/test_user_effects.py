"""Effects of one's own: from a function, from a file, in mechanism.toml and on the command line."""

import json
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident.cli.app import main
from ident.effects import Signals, parse_user
from ident.errors import FitError, MechanismError
from identification import motion_log, plant, robot

SOURCE = '''
import casadi as ca


def bump(s, w=(0.1, 0.02, 0.6)):
    """A rough spot."""
    return {"A": ca.exp(-(((s.q - 0.9) / w) ** 2))}


def cross(s):
    return {"k": s.q[0] * s.q[1], "d": s.v[1]}


def losses(s):
    return {"mu": ca.fabs(s.lam) * ca.tanh(s.v / 0.05)}


def crash(s):
    return {"A": s.q / undefined}


def pole(s):
    return {"A": 1 / (s.q - s.q)}
'''


def bump(s, w=(0.1, 0.02, 0.6)):
    """A rough spot."""
    return {"A": ca.exp(-(((s.q - 0.9) / w) ** 2))}


def signals(joints, shape=None):
    q, v, a, torque, load = np.random.default_rng(0).normal(size=(5, 20, joints))
    return Signals(
        np.arange(20) / 10, q, v, a, np.full(joints, 0.01), shape=shape or {},
        predicted=lambda: (torque, load),
    )  # fmt: skip


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "elsewhere" / "my_effects.py"
    path.parent.mkdir()
    path.write_text(SOURCE)
    return path


def read(file, name):
    return ident.read_user_effect(file, name, allow_code=True)


# --- from a function ----------------------------------------------------------------------------


def test_a_function_becomes_a_kind():
    Bump = ident.user_effect("bump", bump)
    effect = Bump(("elbow",))
    assert effect.label == "bump:elbow"
    assert effect.names == ("bump.elbow.A", "bump.elbow.w")
    assert [shape.name for shape in effect.searched] == ["w"]
    assert effect.bounds(signals(1)) == {"w": (0.02, 0.6)}
    assert effect.starts(signals(1))[0] == {"w": 0.1}
    assert "exp" in effect.equation
    assert not effect.implicit
    s = signals(1, {"w": 0.2})
    np.testing.assert_allclose(
        effect.columns(s)[:, 0, 0], np.exp(-(((s.q[:, 0] - 0.9) / 0.2) ** 2)), rtol=1e-12
    )


def test_units_may_be_given():
    def rough(s, w: "rad" = (0.1, 0.02, 0.6)):  # noqa: F821
        return {"A [N m]": ca.exp(-((s.q / w) ** 2)), "B": s.v}

    effect = ident.user_effect("rough", rough)(("elbow",))
    assert effect.names == ("rough.elbow.A", "rough.elbow.B", "rough.elbow.w")
    assert effect.units == ("N m", "?", "rad")


def test_of_several_joints_the_torque_acts_on_the_first(file):
    effect = read(file, "cross")(("elbow", "shoulder"))
    s = signals(2)
    E = effect.columns(s)
    np.testing.assert_allclose(E[:, 0], np.stack([s.q[:, 0] * s.q[:, 1], s.v[:, 1]], axis=1))
    assert not E[:, 1].any()
    with pytest.raises(MechanismError, match=r"looks at 2 joint.*write cross:joint,joint"):
        read(file, "cross")(("elbow",))


def test_what_the_model_predicts_is_at_hand(file):
    effect = read(file, "losses")(("elbow",))
    assert effect.implicit
    s = signals(1)
    expected = np.abs(s.load) * np.tanh(s.v / 0.05)
    np.testing.assert_allclose(effect.columns(s)[..., 0], expected)


@pytest.mark.parametrize(
    ("name", "function", "says"),
    [
        ("viscous", bump, "is in the library"),
        ("a bump", bump, "is no name"),
        ("bump", lambda s, w=3.0: {"A": s.q * w}, "w=(start, lowest, highest)"),
        ("bump", lambda s, w=(2, 0, 1): {"A": s.q * w}, "w=(start, lowest, highest)"),
        ("bump", lambda s, w: {"A": s.q * w}, "default of w is nothing"),
        ("bump", lambda s: s.q, "returns {'unknown': CasADi expression}"),
        ("bump", lambda s: {}, "returns no unknown"),
        ("bump", lambda s: {"A": ca.vertcat(s.q, s.v)}, "one expression for each name"),
        ("bump", lambda s: {"A": s.speed}, "AttributeError"),
        ("bump", lambda s: {"A": s.q * ca.SX.sym("z")}, "other symbols"),
        ("bump", lambda *, s: {"A": s.q}, "its function fails"),
        ("bump", 3, "is no function"),
    ],
)
def test_functions_that_are_refused(name, function, says):
    with pytest.raises(MechanismError) as caught:
        ident.user_effect(name, function)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_function_that_is_not_finite(file):
    mechanism = robot("arm") + read(file, "pole")(("elbow",))
    motion = ident.complete(robot("arm"), ROBOTS / "arm" / "run.csv")
    with pytest.raises(MechanismError, match=r"'pole:elbow': its function is .* at t = "):
        ident.identify(mechanism, motion)


def test_it_is_found_where_it_was_planted():
    mechanism = robot("arm").with_effect("viscous") + ident.user_effect("bump", bump)(("elbow",))
    true = {"bump.elbow.A": 0.7, "bump.elbow.w": 0.25}
    fit = plant(mechanism, motion_log("arm", 100.0), true).fit()
    for name, value in true.items():
        assert fit[name].value == pytest.approx(value, rel=1e-6)


def test_one_without_a_file_cannot_be_written(tmp_path):
    mechanism = robot("arm") + ident.user_effect("bump", bump)(("elbow",))
    case = plant(mechanism, motion_log("arm", 100.0), {"bump.elbow.A": 0.7, "bump.elbow.w": 0.25})
    with pytest.raises(MechanismError, match="its function is in no file"):
        case.fit().write(tmp_path / "out")
    assert not (tmp_path / "out").exists()


# --- from a file --------------------------------------------------------------------------------


def test_parse_user():
    path, name, joints = parse_user("dir/my_effects.py:bump:elbow, shoulder")
    assert (str(path), name, joints) == ("dir/my_effects.py", "bump", ("elbow", "shoulder"))
    assert parse_user("viscous:elbow") is None
    for text in ("my.py", "my.py:", "my.py:bump", "my.py:bump:", "my.py:bump:a,"):
        with pytest.raises(MechanismError, match=r"my\.py:(bump|function):joint"):
            parse_user(text)


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("bumb", SOURCE, "did you mean 'bump'"),
        ("crash", SOURCE, "NameError"),
        ("bump", "import no_such_module", "ModuleNotFoundError"),
        ("bump", "raise SystemExit('a\\nb')", "SystemExit: a b"),
        ("bump", "def bump(s)", "SyntaxError"),
        ("bump", None, "no such file"),
    ],
)
def test_files_that_are_refused(name, content, says, file):
    file.unlink() if content is None else file.write_text(content)
    with pytest.raises(MechanismError) as caught:
        read(file, name)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.fixture
def arm(tmp_path, file):
    """The arm's folder with a bump of a file that lies beside it."""
    folder = tmp_path / "arm"
    folder.mkdir()
    toml = (ROBOTS / "arm" / "mechanism.toml").read_text()
    toml += '\n[[effect]]\nkind = "bump"\nfile = "../elsewhere/my_effects.py"\njoint = "elbow"\n'
    (folder / "mechanism.toml").write_text(toml)
    (folder / "arm.urdf").write_bytes((ROBOTS / "arm" / "arm.urdf").read_bytes())
    return folder


def test_in_mechanism_toml(arm):
    with pytest.raises(MechanismError, match=r"effect 1: .*would run .*; pass --allow-code"):
        ident.load(arm)
    (effect,) = ident.load(arm, allow_code=True).effects
    assert effect.label == "bump:elbow"
    text = (arm / "mechanism.toml").read_text()
    (arm / "mechanism.toml").write_text(text.replace('file = "../elsewhere/my_effects.py"\n', ""))
    with pytest.raises(MechanismError, match="one of your own needs file"):
        ident.load(arm)


def test_a_fit_with_it_is_written_and_read_back(arm, tmp_path):
    mechanism = ident.load(arm, allow_code=True).with_effect("viscous")
    true = {"bump.elbow.A": 0.7, "bump.elbow.w": 0.25}
    case = plant(mechanism, motion_log("arm", 100.0), true)
    case.fit().write(tmp_path / "out")
    saved = ident.read_fit(tmp_path / "out" / "fit.json", ident.load(arm, allow_code=True))
    for name, value in true.items():
        assert saved.point.values[name] == pytest.approx(value, rel=1e-6)
    again = ident.load(tmp_path / "out" / "identified", allow_code=True)
    assert (tmp_path / "out" / "identified" / "my_effects.py").read_text() == SOURCE
    assert again.effects[0].values == pytest.approx({"A": 0.7, "w": 0.25}, rel=1e-6)
    with pytest.raises(FitError, match="'bump:elbow' is none of the library"):
        ident.read_fit(tmp_path / "out" / "fit.json", ident.load(ROBOTS / "arm"))


@pytest.fixture
def run(monkeypatch, capsys):
    def command(*words):
        monkeypatch.setattr("sys.argv", ["ident", *map(str, words)])
        try:
            main()
            status = 0
        except SystemExit as stop:
            status = int(stop.code or 0)
        return status, capsys.readouterr()

    return command


def test_on_the_command_line(file, run, tmp_path):
    case = plant(
        robot("arm") + read(file, "bump")(("elbow",)),
        motion_log("arm", 100.0),
        {"bump.elbow.A": 0.7, "bump.elbow.w": 0.25},
    )
    case.log.write(tmp_path / "log.csv")
    words = ("identify", ROBOTS / "arm", tmp_path / "log.csv", "--with", f"{file}:bump:elbow")
    status, said = run(*words)
    assert status == 1
    assert "pass --allow-code" in said.err
    status, said = run(*words, "--allow-code", "--cutoff", "none", "--out", tmp_path / "out")
    assert status == 0, said.err
    assert "bump.elbow.w" in said.out
    (effect,) = json.loads((tmp_path / "out" / "fit.json").read_text())["effects"]
    assert [p["value"] for p in effect["parameters"]] == pytest.approx([0.7, 0.25], rel=1e-6)
    status, said = run("check", ROBOTS / "arm", "--with", f"{file}:bump:elbow", "--allow-code")
    assert status == 0, said.err


def test_added_to_a_mechanism(arm, file, run):
    status, said = run("add", arm, f"{file}:cross:elbow,shoulder", "--allow-code")
    assert status == 0, said.err
    assert "added cross:elbow,shoulder" in said.out
    assert 'file = "../elsewhere/my_effects.py"' in (arm / "mechanism.toml").read_text()
    labels = [effect.label for effect in ident.load(arm, allow_code=True).effects]
    assert labels == ["bump:elbow", "cross:elbow,shoulder"]


def test_a_kind_can_be_changed_like_any_effect(file):
    effect = read(file, "bump")(("elbow",))
    assert replace(effect, values={"w": 0.3}).searched == ()
    with pytest.raises(MechanismError, match="no joint 'elbwo'"):
        ident.load(ROBOTS / "arm") + replace(effect, joints=("elbwo",))
