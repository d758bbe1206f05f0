"""A fit does not lean on a wrong prior, does not believe noise, and says what it left out."""

from dataclasses import replace

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident import Log, Noise
from ident.errors import MotionError
from ident.information.estimate import estimate
from ident.information.linear import Triangle
from ident.motion.signals import absurd_samples
from identification import motion_log, plant, robot

NOISE = [Noise("tau", 0.01, relative=True), Noise("q", 2e-5)]
EFFECTS = ("viscous", "coulomb")


def with_friction(name):
    mechanism = robot(name)
    for kind in EFFECTS:
        mechanism = mechanism.with_effect(kind)
    return mechanism


def scaled_prior(name, factor, tmp_path):
    """The robot with all masses and inertias of its URDF multiplied."""
    from lxml import etree

    urdf = etree.parse(ROBOTS / name / f"{name}.urdf")
    for element in urdf.iter("mass"):
        element.set("value", repr(factor * float(element.get("value"))))
    for element in urdf.iter("inertia"):
        for key, value in element.attrib.items():
            element.set(key, repr(factor * float(value)))
    folder = tmp_path / f"{name}_{factor:g}"
    folder.mkdir()
    urdf.write(folder / f"{name}.urdf")
    (folder / "mechanism.toml").write_text((ROBOTS / name / "mechanism.toml").read_text())
    mechanism = ident.load(folder)
    for kind in EFFECTS:
        mechanism = mechanism.with_effect(kind)
    return mechanism


@pytest.mark.parametrize("name", ["arm", "four_bar", "five_bar"])
@pytest.mark.parametrize("factor", [1e-3, 0.1, 10.0, 1e3])
def test_errors_do_not_depend_on_the_prior(name, factor, tmp_path):
    log = ROBOTS / name / "run.csv"
    true = with_friction(name)
    reference = ident.identify(true, ident.complete(true, log))
    wrong = scaled_prior(name, factor, tmp_path)
    fit = ident.identify(wrong, ident.complete(wrong, log))
    for joint, error in fit.held_out.items():
        assert error.rms < 1.3 * reference.held_out[joint].rms


def still_arm(noise):
    """The arm's yaw and shoulder move; elbow and wrist stand still at 0.3 and 0."""
    motion = motion_log("arm", rate=250.0, seconds=8.0)
    columns = dict(motion.columns)
    for joint, where in (("elbow", 0.3), ("wrist", 0.0)):
        columns |= {f"q.{joint}": np.full(len(motion.t), where)}
        columns |= {f"{c}.{joint}": np.zeros(len(motion.t)) for c in "va"}
    made = plant(with_friction("arm"), Log.from_arrays("still.csv", motion.t, columns), noise=noise)
    positions = {k: x for k, x in made.log.columns.items() if k[:2] not in ("v.", "a.")}
    log = Log.from_arrays("still.csv", made.log.t, positions)
    return ident.identify(made.mechanism, ident.complete(made.mechanism, log))


def test_joints_that_stand_still_do_not_make_noise_into_parameters():
    clean, noisy = still_arm([]), still_arm(NOISE)
    assert noisy.rank <= clean.rank
    assert noisy.estimate.fixed.any()
    assert any("cannot tell" in note and "held at the prior" in note for note in noisy.warnings)
    for joint in ("yaw", "shoulder"):
        assert noisy.held_out[joint].relative < 0.01
    held = {noisy.columns.names[i] for i in np.flatnonzero(noisy.estimate.fixed)}
    for value in noisy.parameters:
        if value.name in held:
            assert not value.identifiable
            assert value.value == pytest.approx(value.prior)


@pytest.mark.parametrize("name", ["arm", "five_bar"])
def test_tree_and_absolute_form_agree_on_what_stands_still(name):
    made = plant(with_friction(name), motion_log(name), noise=NOISE)
    bodies = ident.absolute(made.mechanism)
    one, other = made.fit(), made.fit(mechanism=bodies)
    assert [value.name for value in one.base_parameters] == [v.name for v in other.base_parameters]
    for a, b in zip(one.base_parameters, other.base_parameters, strict=True):
        assert b.value == pytest.approx(a.value, rel=1e-7, abs=1e-9)


def test_a_log_too_slow_for_its_own_motion_is_refused_unless_a_filter_is_given():
    mechanism = with_friction("arm")
    good = ident.read_log(ROBOTS / "arm" / "run.csv")
    few = {k: x[::24] for k, x in good.columns.items()}
    fast = Log.from_arrays("fast.csv", good.t[::24] / 2, few)  # 21 Hz, moves up to 3 Hz
    calm = Log.from_arrays("calm.csv", 8 * good.t, good.columns)
    with pytest.raises(MotionError, match=r"fast.csv.*its own motion.*identify it by itself"):
        ident.complete(mechanism, [calm, fast])
    with pytest.raises(MotionError, match=r"fast.csv.*too slow.*that the other logs need"):
        ident.complete(mechanism, [good, fast])
    band = ident.complete(mechanism, [calm, fast], cutoff=4.0).band
    assert band.cutoff == 4.0
    assert band.motion > 2.0


def test_a_log_too_slow_for_the_filter_is_refused_by_name():
    mechanism = with_friction("arm")
    good = ident.read_log(ROBOTS / "arm" / "run.csv")
    slow = Log.from_arrays("slow.csv", good.t[::20], {k: x[::20] for k, x in good.columns.items()})
    with pytest.raises(MotionError, match=r"slow.csv.*too slow"):
        ident.complete(mechanism, [good, slow])


def test_what_the_filter_and_spline_ends_take_is_said():
    mechanism = with_friction("arm")
    good = ident.read_log(ROBOTS / "arm" / "run.csv")
    keep = (good.t < 4.0) | ((good.t > 4.3) & (good.t < 4.6)) | (good.t > 4.9)
    gappy = Log.from_arrays("gap.csv", good.t[keep], {k: x[keep] for k, x in good.columns.items()})
    fit = ident.identify(mechanism, ident.complete(mechanism, gappy))
    assert any("shorter than the filter" in note for note in fit.warnings)
    assert any("where splines end" in note for note in fit.warnings)


def test_a_flipped_torque_and_an_impossible_body_are_noticed():
    mechanism = with_friction("four_bar")
    log = ident.read_log(ROBOTS / "four_bar" / "run.csv")
    flipped = Log.from_arrays(
        "f.csv", log.t, {**log.columns, "tau.crank": -log.columns["tau.crank"]}
    )
    fit = ident.identify(mechanism, ident.complete(mechanism, flipped))
    assert any("came out negative" in note for note in fit.warnings)
    assert any("no possible body" in note for note in fit.warnings)


def test_a_useless_prediction_is_called_so():
    mechanism = robot("arm")
    log = ident.read_log(ROBOTS / "arm" / "run.csv")
    random = np.random.default_rng(0)
    noise = {k: random.standard_normal(len(log.t)) for k in log.columns if k.startswith("tau")}
    known = replace(mechanism, unknown=()).with_effect("viscous")
    fit = ident.identify(
        known, ident.complete(known, Log.from_arrays("n.csv", log.t, {**log.columns, **noise}))
    )
    assert any("parameters are not to be trusted" in note for note in fit.warnings)


def test_multipliers_that_rest_on_priors_are_named():
    fit = ident.identify(
        with_friction("four_bar"),
        ident.complete(with_friction("four_bar"), ROBOTS / "four_bar" / "run.csv"),
    )
    assert any("rest on the priors of rocker_link.mx" in note for note in fit.warnings)


def test_a_mass_alone_unknown_is_pointed_out():
    mechanism = replace(robot("arm"), unknown=("hand.m",))
    fit = ident.identify(mechanism, ident.complete(mechanism, ROBOTS / "arm" / "run.csv"))
    assert any("a known body is wrong" in note for note in fit.warnings)


def test_values_are_found_by_name():
    mechanism = with_friction("arm")
    fit = ident.identify(mechanism, ident.complete(mechanism, ROBOTS / "arm" / "run.csv"))
    assert fit["coulomb.elbow.Fc"].value == pytest.approx(0.9, rel=0.01)
    assert fit["hand.my"].identifiable
    with pytest.raises(KeyError, match=r"coulomb\.elbow\.Fc"):
        fit["coulomb.elbow.fc"]
    assert fit.plot().axes


def test_what_is_held_is_said_to_be_held_even_where_nothing_is_explained():
    random = np.random.default_rng(0)
    A, b = 1e-3 * random.standard_normal((500, 1)), random.standard_normal(500)
    torque = np.array([np.sqrt(np.mean(b**2))])  # the first weights are right at once
    found = estimate([Triangle.of(A, b)], np.array([2.0]), torque, plausible=np.array([0.1]))
    assert found.fixed.all()
    assert found.solution.x == pytest.approx([2.0])
    assert found.base.rank == 0


def test_a_log_far_too_short_is_said_first():
    mechanism, log = ident.load(ROBOTS / "arm"), ident.read_log(ROBOTS / "arm" / "run.csv")

    def warnings(samples: int) -> tuple[str, ...]:
        few = {name: x[:samples] for name, x in log.columns.items()}
        short = Log.from_arrays("short.csv", log.t[:samples], few)
        return ident.identify(mechanism, ident.complete(mechanism, short)).warnings

    assert warnings(49)[0].startswith("only ")
    assert "equations for" in warnings(49)[0]
    assert not any("equations for" in each for each in warnings(1000))


def test_a_column_of_broken_bits_is_only_empty():
    """A bit that flips in a file makes a NaN that signals."""
    x = np.sin(np.linspace(0.0, 6.0, 400))
    x.view(np.uint64)[7] = 0x7FF0000000000001
    assert not absurd_samples(x).size
