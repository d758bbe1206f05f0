"""The walk of docs/inside.md, from a CSV file to fit.json, names functions that are there."""

import re

import pytest

from helpers import ROOT

PAGE = (ROOT / "docs" / "inside.md").read_text(encoding="utf-8")
STEPS = re.findall(r"^\| `(\w+/\w+\.py)`[^|]*\|([^|]+)\|", PAGE, re.MULTILINE)


def test_there_are_steps():
    assert len(STEPS) >= 35


@pytest.mark.parametrize(("file", "named"), STEPS)
def test_a_step_names_functions_of_its_file(file, named):
    own = ROOT / "src" / "ident" / file
    package = "".join(each.read_text(encoding="utf-8") for each in own.parent.glob("*.py"))
    first, *others = (name.split(".")[-1] for name in re.findall(r"`([\w.]+)`", named))
    for name, text in ((first, own.read_text(encoding="utf-8")), *((x, package) for x in others)):
        assert re.search(rf"\b(def|class) {name}\b", text), name
