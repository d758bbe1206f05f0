"""A passive joint that turns as a driven one does: friction of either has the same columns."""

from dataclasses import replace

import numpy as np
import pytest

import ident
from ident import Log, Noise
from ident.assess.diagnosis import causes_of
from ident.diagnosis.candidates import Contest
from ident.diagnosis.diagnosis import candidates_of
from ident.diagnosis.null import with_noise
from ident.diagnosis.search import Search
from identification import motion_log, plant, robot

LINK = (
    '<link name="{0}_link"><inertial><origin xyz="0 0 -{1}"/><mass value="{2}"/><inertia '
    'ixx="0.01" iyy="0.01" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
JOINT = (
    '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{0}_link"/>'
    '<origin xyz="{2} 0 0"/><axis xyz="0 1 0"/>'
    '<limit lower="-3" upper="3" effort="50" velocity="20"/></joint>'
)
MIRROR = (
    'urdf = "two.urdf"\n[joints]\npassive = ["mirror"]\n'
    '[[closure]]\nname = "gear"\nkind = "linear"\njoints = ["first", "mirror"]\nratios = [1, 1]\n'
)


@pytest.fixture(scope="module")
def fit(tmp_path_factory):
    """Of two driven pendulums, one on the other, and a passive one that mirrors the first, without
    the dry friction that both drives have.
    """
    folder = tmp_path_factory.mktemp("mirror")
    chain = (("first", "base", 0.0), ("second", "first_link", 0.1), ("mirror", "base", 0.5))
    bodies = (LINK.format("first", 0.2, 1.0), LINK.format("second", 0.1, 0.5))
    parts = [*bodies, LINK.format("mirror", 0.1, 0.3), *(JOINT.format(*each) for each in chain)]
    text = f'<robot name="two"><link name="base"/>{"".join(parts)}</robot>'
    (folder / "two.urdf").write_text(text)
    (folder / "mechanism.toml").write_text(MIRROR)
    mechanism, t = ident.load(folder), np.arange(0, 10, 0.005)
    angle = np.outer(t, 2 * np.pi * np.array([0.31, 0.53, 0.87]))
    columns = {
        "q.first": np.sin(angle) @ [0.8, 0.3, 0.1],
        "q.second": np.sin(angle + 1) @ [0.3, -0.6, 0.2],
    }
    log, _ = ident.simulate(
        mechanism.with_effect("coulomb:first").with_effect("coulomb:second"),
        Log.from_arrays("run.csv", t, columns),
        values={"coulomb.first.Fc": 0.6, "coulomb.second.Fc": 0.4},
        noise=[Noise("tau", 0.01, relative=True)],
        seed=1,
    )
    return ident.identify(mechanism, ident.complete(mechanism, log, cutoff="auto"))


def test_of_the_same_columns_those_of_a_drive_are_named_first(fit):
    found = ident.diagnose(fit)
    assert found.best.label == "coulomb:first"
    assert [each.label for each in found.rivals] == ["coulomb:mirror"]


@pytest.mark.parametrize(
    "label",
    ["coulomb:first", pytest.param("coulomb:mirror", id="a passive joint that does as well")],
)
def test_what_came_with_others_is_of_a_drive_with_the_passive_joint_as_rival(fit, label):
    contest = with_noise(Contest.of(fit, candidates_of(fit), lambda *_: None))
    search = Search(contest, (), lambda *_: None)
    first = search.ranked(search.start)
    taken = next(e for e in first.credible if e.effect.label == label)
    alone = search.start.plus(taken)
    grouped = replace(alone, members=(replace(alone.members[0], grouped=True),))
    grouped = search.driven_first(grouped)
    (member,) = grouped.members
    assert member.label == "coulomb:first"
    came = search.with_rivals(grouped, member)
    assert "coulomb:mirror" in {each.effect.label for each in came.rivals}


def test_each_of_a_group_has_rivals_of_its_own_and_is_open_then(fit):
    found = ident.diagnose(fit)
    members = {m.label: m for m in found.selection.members}
    first, second = members["coulomb:first"], members["coulomb:second"]
    best = next(x for x in found.every if x.effect.label == second.label)
    selection = replace(found.selection, members=(replace(second, rivals=()), first))
    group = replace(found, selection=selection, candidates=(best, *found.candidates))
    assert [effect.label for effect in group.group] == ["coulomb:second", "coulomb:first"]
    causes = [([e.label for e in c.effects], [e.label for e in c.rivals]) for c in causes_of(group)]
    assert causes == [(["coulomb:second"], []), (["coulomb:first"], ["coulomb:mirror"])]
    assert "Certain (" not in group.short


def test_a_given_friction_moves_to_the_joint_in_which_it_is():
    """That of the rocker was given to the crank."""
    true = robot("four_bar").with_effect("coulomb:rocker")
    noise = [Noise("tau", 0.01, relative=True)]
    case = plant(true, motion_log("four_bar", 100.0, 8.0), {"coulomb.rocker.Fc": 0.5}, noise=noise)
    given = robot("four_bar").with_effect("coulomb:crank")
    history = ident.grow(given, ident.complete(given, case.log))
    assert [effect.label for effect in history.mechanism.effects] == ["coulomb:rocker"]
    assert [e.label for step in history.steps for e in step.removed] == ["coulomb:crank"]
    assert history.fit["coulomb.rocker.Fc"].value == pytest.approx(0.5, rel=0.05)
