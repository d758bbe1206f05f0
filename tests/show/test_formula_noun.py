"""Formulas in sentences, with and without a name of their own."""

from types import SimpleNamespace

import pytest

from ident.show.experiment import formula_noun


@pytest.mark.parametrize(
    ("known_as", "noun"),
    [
        ("end_stop", "an end stop"), ("gas_spring", "a gas spring"),
        ("", "a force of a shape without a name"),
    ],
)  # fmt: skip
def test_a_formula_is_named_by_what_it_is_known_as(known_as, noun):
    formula = SimpleNamespace(terms=[SimpleNamespace(known_as=known_as)])
    assert formula_noun(formula) == noun
