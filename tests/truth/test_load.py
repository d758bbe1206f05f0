"""mechanism.toml and URDF as they are read: every key, and every way to get one wrong."""

import numpy as np
import pinocchio as pin
import pytest

from helpers import J, tree_urdf, write_mechanism
from ident.errors import MechanismError
from ident.log import Column
from ident.mechanism import load
from ident.mechanism.closures import KINDS as ALL
from ident.mechanism.closures import FrameClosure

KINDS = [k for k, c in ALL.items() if issubclass(c, FrameClosure) and k != "distance"]
TREE = [
    J("hip", axis="0 1 0"),
    J("slide", "prismatic", "1 0 0", "hip"),
    J("knee", "continuous", "0 1 0", "slide"),
    J("tool", "fixed", None, "knee"),
    J("flap", axis="1 0 0"),
]
URDF = tree_urdf(TREE, seed=9)
PIN = """
[[closure]]
name = "pin"
kind = "point"
a = { link = "tool_link", xyz = [0.1, 0.2, 0.3], rpy = [0.1, 0.2, 0.3] }
b = { link = "world", xyz = [1.0, 0.0, 0.0] }
"""


@pytest.fixture
def make(tmp_path):
    """`make(toml)`: the mechanism of URDF and these lines."""
    return lambda toml="", urdf=URDF, **options: load(
        write_mechanism(tmp_path, urdf, toml), **options
    )


# --- what is understood -------------------------------------------------------------------------


def test_a_folder_a_toml_and_a_bare_urdf(make, tmp_path):
    mechanism = make()
    assert mechanism.name == tmp_path.name
    assert load(tmp_path / "mechanism.toml").name == tmp_path.name
    assert load(str(tmp_path)).urdf == tmp_path / "robot.urdf"
    bare = load(tmp_path / "robot.urdf")
    assert bare.name == "robot"
    assert bare.closures == ()
    assert bare.passive == ()
    assert set(bare.driven) == {"hip", "slide", "knee", "flap"}
    assert bare.unknown == bare.bodies.names
    assert bare.degrees_of_freedom == 4


def test_defaults(make):
    mechanism = make()
    np.testing.assert_array_equal(mechanism.model.gravity.linear, [0, 0, -9.81])
    np.testing.assert_array_equal(mechanism.start, np.zeros(4))
    assert mechanism.multipliers.basis == "free"
    assert mechanism.multipliers.degree == -1
    assert dict(mechanism.columns) == {}
    assert mechanism.effects == ()


def test_gravity_passive_and_start(make):
    toml = 'gravity = [9.81, 0, -1]\n[joints]\npassive = ["knee", "flap"]\n'
    toml += "start = { hip = 0.3, slide = 1 }"
    mechanism = make(toml)
    np.testing.assert_array_equal(mechanism.model.gravity.linear, [9.81, 0, -1])
    assert set(mechanism.passive) == {"knee", "flap"}
    assert set(mechanism.driven) == {"hip", "slide"}
    assert mechanism.start[mechanism.joint("hip").index] == 0.3
    assert mechanism.start[mechanism.joint("slide").index] == 1.0
    assert mechanism.start[mechanism.joint("knee").index] == 0.0


@pytest.mark.parametrize(("basis", "degree"), [("linear", 1), ("cubic", 3), ("free", -1)])
def test_multipliers(make, basis, degree):
    found = make(f'[multipliers]\nbasis = "{basis}"\nspacing = 0.01').multipliers
    assert (found.basis, found.spacing, found.degree) == (basis, 0.01, degree)


def test_log_columns(make):
    toml = '[log]\n"tau.hip" = { column = "amps", scale = -0.12, offset = 0.5 }\n"t" = "stamp"'
    expected = {"tau.hip": Column("amps", -0.12, 0.5), "t": Column("stamp", 1.0, 0.0)}
    assert dict(make(toml).columns) == expected


def test_effects_with_known_values(make):
    toml = '[[effect]]\nkind = "viscous"\njoint = "slide"\nFv = 0.8\n'
    toml += '[[effect]]\nkind = "spring"\njoint = "hip"'
    one, two = make(toml).effects
    assert (one.label, dict(one.values), one.units) == ("viscous:slide", {"Fv": 0.8}, ("N s/m",))
    assert (two.label, dict(two.values)) == ("spring:hip", {})


def test_an_effect_on_a_closures_own_joint(make):
    toml = (
        PIN.replace("point", "revolute") + '[[effect]]\nkind = "coulomb"\njoint = "closure.pin"\n'
    )
    mechanism = make(toml)
    joint = mechanism.joint("closure.pin")
    assert not joint.in_tree
    assert joint.rotational
    assert mechanism.effects[0].units == ("N m",)
    assert "closure.pin" not in mechanism.driven


def test_known_and_unknown_parameters(make):
    mechanism = make('[parameters]\nunknown = ["hip_link.Ixx", "flap_link"]')
    assert mechanism.unknown[:1] in (("hip_link.Lxx",), ("flap_link.m",))
    assert len(mechanism.unknown) == 11
    assert make("[parameters]\nunknown = []").unknown == ()


def test_fixed_links_are_one_body_with_their_parent(make):
    mechanism = make()
    assert "tool_link" not in mechanism.bodies.links
    knee = mechanism.bodies.columns("knee_link")
    raw = pin.buildModelFromXML(URDF)
    index = raw.getJointId("knee")
    np.testing.assert_allclose(
        mechanism.prior[knee], raw.inertias[index].toDynamicParameters(), atol=1e-12
    )
    with pytest.raises(MechanismError, match="fixed to another is one body with it"):
        make('[parameters]\nunknown = ["tool_link.m"]')


def test_frames_on_links_fixed_to_others_and_on_the_world(make):
    closure = make(PIN).closures[0]
    raw = pin.buildModelFromXML(URDF)
    tool = raw.frames[raw.getFrameId("tool_link", pin.FrameType.BODY)]
    at = tool.placement * pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([0.1, 0.2, 0.3]))
    np.testing.assert_allclose(closure.a.placement.homogeneous, at.homogeneous, atol=1e-12)
    assert (closure.a.link, closure.b.link, closure.b.joint) == ("tool_link", "world", 0)
    np.testing.assert_allclose(closure.b.placement.translation, [1, 0, 0])


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_two_frames_is_read(make, kind):
    mechanism = make(PIN.replace("point", kind))
    assert mechanism.closures[0].kind == kind
    assert f"pin ({kind})" in str(mechanism)


def test_a_world_that_the_urdf_does_not_declare(tmp_path):
    urdf = tree_urdf([J("a")], base="world").replace('<link name="world"/>', "")
    mechanism = load(write_mechanism(tmp_path, urdf))
    assert mechanism.degrees_of_freedom == 1
    assert any("does not declare the link 'world'" in note for note in mechanism.notes)


def test_continuous_joints_are_angles_without_limits(make):
    knee = make().joint("knee")
    assert knee.rotational
    assert (knee.lower, knee.upper) == (-np.inf, np.inf)
    mechanism = make()
    assert mechanism.model.nq == mechanism.model.nv


def test_mimics_are_linear_closures(tmp_path):
    mimic = '<mimic joint="a" multiplier="-2" offset="0.3"/>'
    mechanism = load(
        write_mechanism(tmp_path, tree_urdf([J("a"), J("b", parent="a", inside=mimic)]))
    )
    assert mechanism.passive == ("b",)
    assert mechanism.degrees_of_freedom == 1
    assert mechanism.kinematics.multipliers == ("mimic.b.1",)
    q = np.zeros(2)
    q[mechanism.joint("a").index], q[mechanism.joint("b").index] = 0.7, -2 * 0.7 + 0.3
    assert mechanism.kinematics.closure_rows(q[None]).value[0] == pytest.approx([0.0])


def test_an_inertia_that_no_body_has_is_a_placeholder(tmp_path):
    """Gazebo's dummy links: 1 kg m² at a milligram would turn the prior of the last body."""
    inertia = '<inertia ixx="{0}" ixy="0" ixz="0" iyy="{0}" iyz="0" izz="{0}"/>'
    dummy = '<link name="tool"><inertial><mass value="1e-6"/>' + inertia + "</inertial></link>"
    fixed = '<joint name="f" type="fixed"><parent link="a_link"/><child link="tool"/></joint>'
    priors, notes = [], []
    for size in ("1", "1e-9"):
        urdf = tree_urdf([J("a")]).replace("</robot>", dummy.format(size) + fixed + "</robot>")
        mechanism = load(write_mechanism(tmp_path / size, urdf))
        priors.append(mechanism.prior)
        notes += [note for note in mechanism.notes if "placeholder" in note]
    assert priors[0] == pytest.approx(priors[1], abs=1e-8)
    assert len(notes) == 1
    assert "link 'tool': an inertia of 1 kg m² at 1e-06 kg has a radius of gyration" in notes[0]


def test_a_link_without_inertial_is_said_to_be_massless(tmp_path):
    urdf = urdf_of("continuous")
    mechanism = load(write_mechanism(tmp_path, urdf))
    assert any("'l' has no <inertial>" in note for note in mechanism.notes)
    assert np.all(mechanism.prior == 0)


@pytest.mark.parametrize("name", ["arm", "four_bar", "five_bar", "slider_crank", "pendulum"])
def test_the_robots_assemble_and_print_themselves(name, robots):
    dof, equations, rank = {
        "arm": (4, 0, 0),
        "four_bar": (1, 5, 2),
        "five_bar": (2, 3, 2),
        "slider_crank": (1, 3, 3),
        "pendulum": (1, 2, 2),
    }[name]
    mechanism = load(robots / name)
    assert mechanism.degrees_of_freedom == dof
    assert mechanism.rank == rank
    assert len(mechanism.kinematics.multipliers) == equations
    assert (
        np.abs(mechanism.kinematics.closure_rows(mechanism.assembled[None]).value).max(initial=0)
        < 1e-12
    )
    text = str(mechanism)
    assert text.startswith(f"mechanism {name}: ")
    assert f"{equations} closure equations of rank {rank}, {dof} degrees of freedom" in text
    assert repr(mechanism) == text
    assert f"mechanism {name}" in mechanism._repr_html_()


def test_a_machine_drawn_in_a_special_position(tmp_path):
    # a parallelogram with all links in line: J loses a rank there, the machine gains no freedom
    joints = [("c", "world", "0 0 0"), ("k", "c_link", "0.1 0 0"), ("r", "world", "0.3 0 0")]
    urdf = '<robot name="p"><link name="world"/>' + "".join(
        f'<link name="{n}_link"/><joint name="{n}" type="continuous"><parent link="{p}"/>'
        f'<child link="{n}_link"/><origin xyz="{xyz}"/><axis xyz="0 0 1"/></joint>'
        for n, p, xyz in joints
    )
    pin_ = PIN.split("a =")[0] + (
        'a = { link = "k_link", xyz = [0.3, 0, 0] }\nb = { link = "r_link", xyz = [0.1, 0, 0] }'
    )
    mechanism = load(write_mechanism(tmp_path, urdf + "</robot>", pin_))
    J = mechanism.kinematics.closure_rows(mechanism.assembled[None]).rate[0]
    assert np.linalg.matrix_rank(J) == 1
    assert (mechanism.rank, mechanism.degrees_of_freedom) == (2, 1)


# --- functions ----------------------------------------------------------------------------------

CODE = '[[closure]]\nname = "f"\nkind = "function"\nfile = "mine.py"\nfunction = "phi"\n'


@pytest.mark.parametrize(
    ("body", "value"),
    [
        ('q["hip"] + 2 * q["slide"]', [0.7]),
        ('[q["hip"], q["slide"] ** 2]', [0.1, 0.09]),
        ('len(q) * q["hip"]', [0.4]),
        ("sum(q[name] for name in q)", [0.4]),
    ],
)
def test_a_users_function(make, tmp_path, body, value):
    (tmp_path / "mine.py").write_text(f"import casadi as ca\ndef phi(q):\n    return {body}\n")
    mechanism = make(CODE, allow_code=True)
    q = np.zeros(4)
    q[mechanism.joint("hip").index], q[mechanism.joint("slide").index] = 0.1, 0.3
    assert mechanism.kinematics.closure_rows(q[None]).value[0] == pytest.approx(value)
    assert mechanism.kinematics.multipliers == tuple(f"f.{i + 1}" for i in range(len(value)))


def test_a_users_function_runs_only_when_allowed(make, tmp_path):
    (tmp_path / "mine.py").write_text("raise SystemExit('it ran')")
    with pytest.raises(MechanismError, match=r"mine\.py; pass --allow-code"):
        make(CODE)


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("phi = 3", "no function 'phi'"),
        ("import nothing_of_the_kind", "ModuleNotFoundError"),
        ("def phi(q):\n    return q['elbow']", "elbow"),
        ("def phi(q):\n    return 'zero'", "its function fails"),
        ("def phi(q):\n    return None", "its function fails"),
        ("import casadi as ca\ndef phi(q):\n    return ca.SX.sym('z')", "symbols of its own (z)"),
        (None, "no such file"),
    ],
)
def test_a_users_function_that_fails(make, tmp_path, code, says):
    if code is not None:
        (tmp_path / "mine.py").write_text(code)
    with pytest.raises(MechanismError) as caught:
        make(CODE, allow_code=True).rank  # noqa: B018
    assert says in str(caught.value)


# --- what is refused ----------------------------------------------------------------------------

REFUSED = {
    "an unknown key": ("gravitiy = [0, 0, -9]", "did you mean 'gravity'"),
    "gravity of two": ("gravity = [0, -9]", "3 finite numbers"),
    "gravity of text": ('gravity = ["a", 0, 0]', "3 finite numbers"),
    "gravity of nan": ("gravity = [nan, 0, 0]", "3 finite numbers"),
    "no toml": ("gravity = [", "no valid TOML"),
    "joints no table": ("joints = 3", "[joints] must be a table"),
    "an unknown passive joint": ('[joints]\npassive = ["hipp"]', "did you mean 'hip'"),
    "passive no list": ('[joints]\npassive = "hip"', "a list of texts"),
    "an unknown start": ("[joints]\nstart = { hipp = 1 }", "did you mean 'hip'"),
    "a start of text": ('[joints]\nstart = { hip = "1" }', "finite number"),
    "start no table": ("[joints]\nstart = 3", "{ joint = 0.0"),
    "an unknown joints key": ("[joints]\npasive = []", "did you mean 'passive'"),
    "an unknown parameter": ('[parameters]\nunknown = ["hip_link.Jxx"]', "valid: Ixx, Ixy"),
    "an unknown link": ('[parameters]\nunknown = ["hop_link"]', "did you mean 'hip_link'"),
    "an unknown basis": ('[multipliers]\nbasis = "cubics"', "did you mean 'cubic'"),
    "no spacing": ('[multipliers]\nbasis = "linear"', "spacing above 0 s"),
    "a scale of zero": ('[log]\n"t" = { column = "a", scale = 0 }', "scale = 0"),
    "an unknown log key": ('[log]\n"t" = { column = "a", skale = 1 }', "did you mean 'scale'"),
    "no column": ('[log]\n"t" = { scale = 1 }', "no key 'column'"),
    "an effect without a joint": ('[[effect]]\nkind = "viscous"', "joint"),
    "an unknown effect": ('[[effect]]\nkind = "viscose"\njoint = "hip"', "did you mean 'viscous'"),
    "an effect on nothing": ('[[effect]]\nkind = "viscous"\njoint = "hipp"', "did you mean 'hip'"),
    "an effect twice": ('[[effect]]\nkind = "viscous"\njoint = "hip"\n' * 2, "already"),
    "an effect's unknown value": ('[[effect]]\nkind = "viscous"\njoint = "hip"\nFw = 1', "Fv"),
    "effect no table": ("effect = 3", "[[effect]]"),
    "an unknown kind": (PIN.replace("point", "pont"), "did you mean 'point'"),
    "a closure twice": (PIN * 2, "two closures are named 'pin'"),
    "axes elsewhere": (PIN.replace("point", "revolute") + 'axes = "xy"', "unknown key 'axes'"),
    "axes twice": (PIN + 'axes = "xx"', "letters xyz"),
    "no axes": (PIN + 'axes = ""', "axes"),
    "an unknown closure link": (
        PIN.replace('"tool_link"', '"tol_link"'),
        "did you mean 'tool_link'",
    ),
    "a frame without a link": (PIN.replace('link = "world", ', ""), "no key 'link'"),
    "no frame": (PIN.replace("b = { link", "c = { link"), "unknown key 'c'"),
    "xyz of two": (PIN.replace("[1.0, 0.0, 0.0]", "[1.0, 0.0]"), "3 finite numbers"),
    "no length": (PIN.replace("point", "distance"), "above 0"),
    "a closure without a name": (PIN.replace('name = "pin"', ""), "no key 'name'"),
    "one joint": (
        '[[closure]]\nname = "g"\nkind = "linear"\njoints = ["hip"]\nratios = [1]',
        "two or more",
    ),
    "more ratios": (
        '[[closure]]\nname = "g"\nkind = "linear"\njoints = ["hip", "knee"]\nratios = [1, 2, 3]',
        "one ratio each",
    ),
    "a ratio of zero": (
        '[[closure]]\nname = "g"\nkind = "linear"\njoints = ["hip", "knee"]\nratios = [1, 0]',
        "ties nothing",
    ),
    "a gear on nothing": (
        '[[closure]]\nname = "g"\nkind = "linear"\njoints = ["hip", "kne"]\nratios = [1, 1]',
        "did you mean 'knee'",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_one_line_with_the_place(case, make, tmp_path):
    toml, says = REFUSED[case]
    with pytest.raises(MechanismError) as caught:
        make(toml)
    message = str(caught.value)
    assert says in message
    assert len(message.splitlines()) == 1
    assert str(tmp_path) in message


@pytest.mark.parametrize(
    ("path", "says"),
    [("", "no mechanism.toml"), ("nothing", "no such file"), ("robot.yaml", "is no mechanism")],
)
def test_paths_that_are_no_mechanism(path, says, tmp_path):
    (tmp_path / "robot.yaml").write_text("")
    with pytest.raises(MechanismError, match=says):
        load(tmp_path / path)


def test_a_toml_without_its_urdf(tmp_path):
    (tmp_path / "mechanism.toml").write_text('urdf = "gone.urdf"')
    with pytest.raises(MechanismError, match=r"gone\.urdf.*no such file"):
        load(tmp_path)
    (tmp_path / "mechanism.toml").write_text("")
    with pytest.raises(MechanismError, match="no key 'urdf'"):
        load(tmp_path)


@pytest.mark.usefixtures("short_search")
def test_loops_that_do_not_close_are_said(make):
    urdf = tree_urdf([J("a"), J("b", parent="a")], seed=1)
    far = PIN.replace("tool_link", "b_link").replace("[1.0, 0.0, 0.0]", "[100.0, 0.0, 0.0]")
    mechanism = make(far, urdf)
    with pytest.raises(MechanismError, match=r"do not close from \[joints\] start.*'pin' by"):
        mechanism.assembled  # noqa: B018
    assert "do not close" in str(mechanism)  # it prints itself all the same


@pytest.mark.usefixtures("short_search")
def test_a_loop_that_cannot_close_by_itself_is_told_from_the_others(make):
    """A point that would meet another 100 m away, beside two joints that a ratio ties."""
    urdf = tree_urdf([J("a"), J("b", parent="a")], seed=1)
    far = PIN.replace("tool_link", "b_link").replace("[1.0, 0.0, 0.0]", "[100.0, 0.0, 0.0]")
    tie = '[[closure]]\nname = "tie"\nkind = "linear"\njoints = ["a", "b"]\nratios = [1.0, 1.0]\n'
    with pytest.raises(MechanismError, match=r"\('pin' does not close alone: frames or"):
        make(far + "\n" + tie, urdf).assembled  # noqa: B018


JOINT = (
    '<joint name="j" type="{type}"><parent link="{parent}"/><child link="{child}"/>{more}</joint>'
)
LINKS = '<link name="base"/><link name="l"/>'


def urdf_of(kind="revolute", parent="base", child="l", more="", links=LINKS, extra=""):
    joint = JOINT.format(type=kind, parent=parent, child=child, more=more)
    return f'<robot name="r">{links}{joint}{extra}</robot>'


BAD_URDF = {
    "no xml": ("<robot", "no well-formed XML"),
    "empty": ("", "no well-formed XML"),
    "another root": ("<sdf/>", "the root element is <sdf>"),
    "a namespace": ('<robot xmlns="urn:other" name="r"/>', 'take xmlns="…" out'),
    "an entity bomb": ('<!DOCTYPE r [<!ENTITY a "b">]>' + urdf_of(), "document type"),
    "no link": ('<robot name="r"/>', "no <link>"),
    "nothing moves": (urdf_of("fixed"), "every joint is fixed"),
    "an unknown type": (urdf_of("revolut"), "did you mean 'revolute'"),
    "an unknown parent": (urdf_of(parent="bas"), "did you mean 'base'"),
    "two links of a name": (
        urdf_of(links=LINKS + '<link name="l"/>'),
        "a second link is named 'l'",
    ),
    "an axis of zero": (urdf_of(more='<axis xyz="0 0 0"/>'), "axis 0 0 0"),
    "an axis of text": (urdf_of(more='<axis xyz="a b c"/>'), "3 finite numbers"),
    "swapped limits": (urdf_of(more='<limit lower="1" upper="-1"/>'), "swap them"),
    "a mimic of nothing": (urdf_of(more='<mimic joint="k"/>'), "mimics 'k'"),
    "a mimic of itself": (urdf_of(more='<mimic joint="j"/>'), "mimics 'j'"),
    "a ring": (
        '<robot name="r"><link name="a"/><link name="b"/>'
        '<joint name="x" type="revolute"><parent link="a"/><child link="b"/></joint>'
        '<joint name="y" type="revolute"><parent link="b"/><child link="a"/></joint></robot>',
        "ring",
    ),
    "a link of two joints": (
        urdf_of(
            extra='<joint name="k" type="revolute"><parent link="base"/><child link="l"/></joint>'
        ),
        "child of two joints",
    ),
    "a lost link": (urdf_of(links=LINKS + '<link name="lost"/>'), "no joint leads"),
    "a negative mass": (
        urdf_of(
            links='<link name="base"/><link name="l"><inertial><mass value="-1"/>'
            '<inertia ixx="1" iyy="1" izz="1"/></inertial></link>'
        ),
        "must be ≥ 0",
    ),
    "no inertia": (
        urdf_of(
            links='<link name="base"/><link name="l"><inertial><mass value="1"/></inertial></link>'
        ),
        "no <inertia>",
    ),
}


@pytest.mark.parametrize("case", BAD_URDF)
def test_a_urdf_that_is_none(case, tmp_path):
    text, says = BAD_URDF[case]
    (tmp_path / "bad.urdf").write_text(text)
    with pytest.raises(MechanismError) as caught:
        load(tmp_path / "bad.urdf")
    message = str(caught.value)
    assert says in message
    assert len(message.splitlines()) == 1
    assert "bad.urdf" in message


def test_where_nothing_is_driven_it_is_said(make):
    some = make('[joints]\npassive = ["hip", "slide"]\n')
    none = make('[joints]\npassive = ["hip", "slide", "knee", "flap"]\n')
    assert not any("nothing is driven" in note for note in some.notes)
    assert any("nothing is driven" in note for note in none.notes)


def test_what_is_left_open_has_a_unit(make):
    far = make(PIN.replace("xyz = [1.0,", "xyz = [100.0,"))
    with pytest.raises(MechanismError, match=r"'pin' by [0-9.e+]+ m;"):
        assert far.assembled.any()


def test_wrong_mimics_are_said_at_once_with_the_options_that_load_it(tmp_path):
    extra = "".join(
        f'<link name="l{i}"/><joint name="k{i}" type="revolute"><parent link="l"/>'
        f'<child link="l{i}"/><limit lower="0" upper="1"/><mimic joint="{of}"/></joint>'
        for i, of in enumerate(("x", "j", "y"))
    )
    (tmp_path / "r.urdf").write_text(urdf_of(extra=extra))
    with pytest.raises(MechanismError) as caught:
        load(tmp_path / "r.urdf")
    said = str(caught.value)
    assert "joint 'k0' mimics 'x'" in said
    assert "in the same way 'k2' mimics 'y' (line" in said
    assert said.endswith("take them as fixed: --lock k0 --lock k2")
    assert len(load(tmp_path / "r.urdf", locked={"k0": None, "k2": None}).joints) == 2
