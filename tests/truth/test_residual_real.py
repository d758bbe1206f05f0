"""Where friction alone fails on the Stäubli TX40: joints 5 and 6, which share a motor."""

import pytest

import ident


@pytest.fixture(scope="module")
def failures(shared_data):
    folder = shared_data / "staubli_tx40"
    mechanism = ident.load(folder / "tx40.urdf").with_effect("viscous").with_effect("coulomb")
    fit = ident.identify(mechanism, ident.complete(mechanism, folder / "tx40.csv"))
    residual = ident.residual_of(fit)
    for joint, error in fit.train.items():
        assert residual.errors[joint].rms == pytest.approx(error.rms, rel=1e-9)
    return residual.where


def test_joints_5_and_6_fail_by_each_other_s_speed(failures):
    fifth, sixth = failures[:2]
    assert (fifth.joint, sixth.joint) == ("joint_5", "joint_6")
    assert fifth.depends_on[0].signal == "v.joint_6"
    assert sixth.depends_on[0].signal == "v.joint_5"
    assert min(fifth.depends_on[0].r2, sixth.depends_on[0].r2) > 0.7
    assert fifth.share + sixth.share > 0.85
    assert not any(each.white for each in (fifth, sixth))


def test_joint_2_fails_at_one_time(failures):
    """As it slows down, not as it stands until 8.94 s, where dry friction holds what is left."""
    (second,) = (each for each in failures if each.joint == "joint_2")
    assert second.worst[0].stop == pytest.approx(5.65, abs=0.05)
