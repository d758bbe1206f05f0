"""What is said of a formula: its constants, and the law of the literature that is closest."""

from types import SimpleNamespace

import pytest

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
