"""What errors of known values may leave on another log is said, and is not called too little."""

from __future__ import annotations

from dataclasses import replace

from ident.assess.assessment import Assessment, Remainder
from ident.show.headline import remainder_sentence

REMAINDER = Remainder(("crank",), (0.036, 0.036), (17.0, 17.0))


def sentence(within_known: bool) -> str:
    """The sentence on what a diagnosis leaves that names nothing."""
    left = replace(REMAINDER, within_known=within_known)
    return remainder_sentence(Assessment("fb on full.csv", "nothing", (), left=left))


def test_what_known_values_make_is_said():
    assert "standard errors of the known values" in sentence(True)
    assert "too little to matter" in sentence(False)
