"""An effect that changes another one stays only together with it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

import ident
from ident import Noise
from ident.diagnosis.candidates import Contest
from ident.diagnosis.effect_set import EffectSet, Member
from ident.diagnosis.grow import led_at_reversals, undetermined
from identification import motion_log, plant, robot


def grown():
    mechanism = robot("arm").with_effect("coulomb:elbow").with_effect("friction_width:elbow")
    case = plant(mechanism, motion_log("arm"), noise=[Noise("tau", 0.01, relative=True)])
    return mechanism, ident.identify(mechanism, ident.complete(mechanism, case.log))


def test_a_set_says_what_its_effects_require():
    mechanism, fit = grown()
    contest = Contest.of(fit, [], lambda *_: None, curved=False)
    dry, wide = (Member(e, np.array([0]), SimpleNamespace()) for e in mechanism.effects)
    found = EffectSet(contest, (dry, wide))
    assert found.required == {"coulomb:elbow"}
    assert replace(found, members=(dry,)).required == set()
    search = SimpleNamespace(new=lambda s: list(s.members), first=SimpleNamespace(
        gains={m.label: (0.5,) for m in (dry, wide)}))  # fmt: skip
    left = led_at_reversals(search, found, {wide.label})
    assert left is not None
    assert left.labels == {"coulomb:elbow", "friction_width:elbow"}


def test_what_another_effect_changes_does_not_leave_before_it():
    mechanism, fit = grown()
    nothing = tuple(
        replace(e, parameters=tuple(replace(v, value=0.0, stderr=1.0) for v in e.parameters))
        for e in fit.effects
    )
    vague = SimpleNamespace(
        mechanism=mechanism, without_faults=None, effects_with=lambda covariance: nothing
    )
    assert undetermined(vague, mechanism.effects) == "friction_width:elbow"
    alone = SimpleNamespace(
        mechanism=mechanism.without("friction_width:elbow"),
        without_faults=None,
        effects_with=lambda covariance: nothing[:1],
    )
    assert undetermined(alone, mechanism.effects) == "coulomb:elbow"
