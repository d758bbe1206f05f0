"""What is believed is decided in one file, which every engine that judges a residual asks."""

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[1] / "src" / "ident"
RULE = "information/evidence.py"
ENGINES = {  # file: what it asks the rule
    "diagnosis/selection.py": {"credible", "rivals_of"},
    "diagnosis/effect_set.py": {"credible"},
    "diagnosis/changes.py": {"credible", "surprise"},
    "faults/search.py": {"credible", "rivals_of", "leaves_as_little", "surely_t"},
    "faults/small_errors.py": {"credible", "surely_t"},
    "faults/data_checks.py": {"credible"},
    "faults/disagreements.py": {"credible", "surprise", "leaves_as_little", "nearly_best"},
    "streams/suspects.py": {"credible", "rivals_of", "zscore_in_noise"},
    "streams/causes.py": {"credible"},
    "assess/exploration.py": {"credible"},
    "diagnosis/experiment.py": {"nearly_best"},
    "diagnosis/validation.py": {"surely_t"},
}
CAUSES = {  # file: the class there of what may be wrong, missing or changed
    "mechanism/causes.py": "CalibrationError",
    "faults/fault.py": "Fault",
    "diagnosis/changes.py": "Course",
}
PLANNERS = ("diagnosis/experiment.py", "assess/experiment.py", "excite/excitation.py")


def tree(file: str) -> ast.Module:
    return ast.parse((SOURCE / file).read_text(encoding="utf-8"))


def calls(file: str) -> set[str]:
    """Names of the functions that a file calls by name."""
    nodes = (node for node in ast.walk(tree(file)) if isinstance(node, ast.Call))
    return {node.func.id for node in nodes if isinstance(node.func, ast.Name)}


@pytest.mark.parametrize("file", ENGINES)
def test_an_engine_asks_the_rule(file):
    assert ENGINES[file] <= calls(file)


@pytest.mark.parametrize("file", PLANNERS)
def test_a_planner_measures_with_the_one_number(file):
    assert "share_apart" in calls(file)


def classes(file: str) -> dict[str, list[str]]:
    """Bases of the classes that a file defines, by name."""
    nodes = (node for node in ast.walk(tree(file)) if isinstance(node, ast.ClassDef))
    return {x.name: [b.id for b in x.bases if isinstance(b, ast.Name)] for x in nodes}


def test_a_cause_is_one_thing():
    files = [str(path.relative_to(SOURCE)) for path in SOURCE.rglob("*.py")]
    assert [file for file in files if "Cause" in classes(file)] == ["information/cause.py"]
    assert all("Cause" in classes(file)[name] for file, name in CAUSES.items())


def test_thresholds_of_the_rule_are_defined_once():
    def constants(file: str) -> set[str]:
        targets = (
            target
            for node in tree(file).body
            if isinstance(node, ast.Assign)
            for target in node.targets
        )
        names = {target.id for target in targets if isinstance(target, ast.Name)}
        return {name for name in names if name.isupper()}

    general = {"TINY", "DIFFERENT"}  # of numerics, which other files have by the same names
    of_rule = constants(RULE) - general
    files = (str(path.relative_to(SOURCE)) for path in SOURCE.rglob("*.py"))
    again = {file: constants(file) & of_rule for file in files if file != RULE}
    assert not {file: names for file, names in again.items() if names}


def test_no_standard_errors_are_held_against_a_number_of_their_own():
    """`zscore(D) > 2.5` would be a rule of its own; named thresholds are those of the rule."""
    statistics, literal = {"zscore", "paired", "zscore_in_noise"}, []
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Compare):
                continue
            sides = [node.left, *node.comparators]
            called = {
                side.func.id
                for side in sides
                if isinstance(side, ast.Call) and isinstance(side.func, ast.Name)
            }
            numbers = [s.value for s in sides if isinstance(s, ast.Constant) and s.value]
            if called & statistics and numbers:
                literal.append(f"{path.name}:{node.lineno}")
    assert not literal
