"""A next command with many options: a page folds it, and its button copies all of it."""

import pytest

from ident.show.card import Card
from ident.show.html import piece

WORDS = [word for i in range(14) for word in ("--with", f"viscous:panda_joint{i}")]
LONG = " ".join(["ident", "identify", "arm", "run.csv", *WORDS])


@pytest.mark.parametrize(("command", "folded"), [(LONG, True), ("ident check arm", False)])
def test_a_long_command_is_folded_on_a_page_and_copied_whole(command, folded):
    page = str(piece("card", Card("A line", command=command, then="identify.")))
    assert ("ident identify … with 14 effects</summary>" in page) == folded
    assert f'data-copy="{command}"' in page
