"""Every named number states its kind, and the tuned ones do not become more."""

import importlib.util
from collections import Counter
from pathlib import Path

MOST_TUNED = 57
FILE = Path(__file__).resolve().parents[1] / "benchmarks" / "inside.py"


def test_each_number_states_its_kind_and_few_are_tuned():
    spec = importlib.util.spec_from_file_location("inside", FILE)
    inside = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(inside)
    numbers = list(inside.named_numbers())
    assert not [f"{module}.{name}" for module, name, kind in numbers if kind == "without a kind"]
    assert Counter(kind for *_, kind in numbers)["tuned"] <= MOST_TUNED
