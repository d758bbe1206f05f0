"""What is said of a formula: its constants, and the law of the literature that is closest."""

from types import SimpleNamespace

import pytest

from ident.assess.verdict import formulas_explain
from ident.fit.values import Value
from ident.show.laws import law_words


@pytest.mark.parametrize(("k", "said"), [(1.5, False), (-1.5, True)])
def test_a_sign_that_the_closest_law_cannot_have_is_said(k, said):
    law = SimpleNamespace(
        found=SimpleNamespace(nearest="stribeck", distance=0.0),
        joint="elbow",
        formula="k*sign(v)*exp(-(v/v0)**2)",
        parameters=(Value("law.elbow.k", k, 0.01, "N m", True, 0.0),),
    )
    words = law_words(law)
    assert "closest known law: stribeck" in words
    assert ("which cannot have this sign" in words) is said


def test_formulas_explain_what_takes_half_of_the_error_and_less_lowers_it():
    """All of them together, each in its joint."""

    def law(felt, *errors):
        before, after = (
            {"yaw": SimpleNamespace(rms=x), "elbow": SimpleNamespace(rms=1.0)} for x in errors
        )
        return SimpleNamespace(felt=felt, before=before, after=after)

    one, both = law("yaw", 4.0, 3.0), law("yaw", 3.0, 1.0)
    assert not formulas_explain(SimpleNamespace(laws=[one]))
    assert formulas_explain(SimpleNamespace(laws=[one, both]))
    assert not formulas_explain(SimpleNamespace(laws=[one, both, law("elbow", 1.0, 1.0)]))
