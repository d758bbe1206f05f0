"""The Stäubli TX40: friction and the coupling of its wrist are found without being told of."""

import pytest

import ident

PUBLISHED = {"Fvm": (0.60, 0.62), "Fcm": (1.95, 2.03)}  # data/README.md; Im 0.0077-0.0096


@pytest.fixture(scope="module")
def arm(shared_data):
    folder = shared_data / "staubli_tx40"
    mechanism = ident.load(folder / "tx40.urdf")
    return mechanism, ident.complete(mechanism, folder / "tx40.csv")


def within(value, low, high, share=0.10):
    return (1 - share) * low <= value <= (1 + share) * high


def test_the_coupling_is_named(arm):
    mechanism, motion = arm
    fit = ident.identify(mechanism.with_effect("viscous").with_effect("coulomb"), motion)
    found = ident.diagnose(fit)
    assert found.verdict == "missing"
    assert found.best.label == "coupling:joint_5,joint_6"
    assert not found.rivals
    best = found.candidates[0]
    assert best.error_before > 0.5
    assert best.error_after < 0.17
    for value in best.parameters:
        word = value.name.rpartition(".")[2]
        assert word == "Im" or within(value.value, *PUBLISHED[word]), value
    hidden = {each.effect.label for each in found.invisible}
    assert {"rotor_inertia:joint_1", "encoder_offset:joint_1", "payload:link_6"} <= hidden


@pytest.mark.slow
def test_it_grows_from_rigid_bodies(arm):
    mechanism, motion = arm
    history = ident.grow(mechanism, motion)
    labels = {effect.label for effect in history.added}
    assert "coupling:joint_5,joint_6" in labels
    for joint in ("joint_1", "joint_2", "joint_3", "joint_4"):
        assert {f"viscous:{joint}", f"coulomb:{joint}"} <= labels
    errors = {joint: 100 * e.relative for joint, e in history.fit.held_out.items()}
    assert all(errors[joint] <= 11.0 for joint in list(errors)[:4]), errors
    assert all(errors[joint] <= 17.0 for joint in list(errors)[4:]), errors
    for word, (low, high) in PUBLISHED.items():
        assert within(history.fit[f"coupling.joint_5,joint_6.{word}"].value, low, high), word
    assert history.diagnosis.verdict == "unexplained"  # real friction has more in it than this
