"""diagnosis.json, report.html, suggestion.py and the grown folder: the contract, whole or not."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnosed import clean, grown, lacking, lawful, loop, planted

import ident
from helpers import ROBOTS
from ident import Diagnosis, IdentError
from ident.effects.library import named
from ident.files import jsonable
from ident.show.diagnosis import candidate_rows, card
from ident.show.ladder import history_card
from pages import charts, read_page, reading, titles

NUMBER, NUMBER_OR_NONE = (int, float), (int, float, type(None))
NAME = {"effect": str, "joints": [str]}
CONTRACT: dict[str, Any] = {
    "schema": str,
    "verdict": str,
    "where": [
        {
            "joint": str,
            "rms": NUMBER,
            "relative": NUMBER_OR_NONE,
            "share": NUMBER,
            "depends_on": [str],
            "worst": [[NUMBER]],
            "white": bool,
        }
    ],
    "candidates": [
        {
            **NAME,
            "error_before": NUMBER_OR_NONE,
            "error_after": NUMBER_OR_NONE,
            "fall": NUMBER,
            "p_value": NUMBER,
            "visible": NUMBER,
            "rivals": [NAME],
            "parameters": [{"name": str, "value": NUMBER, "stderr": NUMBER_OR_NONE, "unit": str}],
        }
    ],
    "decision": {"alpha": NUMBER, "material": NUMBER, "rival_se": NUMBER},
    "invisible": [{**NAME, "why": str}],
    "next_experiment": str,
    "assessment": dict,
    "text": str,
}


def check(content: Any, shape: Any, place: str = "") -> None:
    """Every key of the contract is there with its type; further keys are allowed."""
    if isinstance(shape, dict):
        assert isinstance(content, dict), place
        for key, inner in shape.items():
            assert key in content, f"{place}.{key}"
            check(content[key], inner, f"{place}.{key}")
    elif isinstance(shape, list):
        assert isinstance(content, list), place
        for i, each in enumerate(content):
            check(each, shape[0], f"{place}[{i}]")
    else:
        assert isinstance(content, shape), f"{place}: {content!r}"


def refuse(constant: str) -> None:
    raise AssertionError(f"{constant} is no JSON")


@pytest.mark.parametrize("make", [clean, lacking, loop], ids=lambda f: f.__name__)
def test_diagnosis_json_keeps_the_contract(make, tmp_path):
    d = make()
    paths = d.write(tmp_path / "out")
    assert {path.name for path in paths} == {"diagnosis.json", "report.html"}
    raw = (tmp_path / "out/diagnosis.json").read_text(encoding="utf-8")
    data = json.loads(raw, parse_constant=refuse)
    assert data == d.json()
    assert data["schema"] == "ident.diagnosis/1"
    check(data, CONTRACT)
    if d.best is None:
        assert data["best"] is None
    else:
        check(data["best"], NAME)
        first = data["candidates"][0]
        assert data["best"] == {key: first[key] for key in ("effect", "joints")}
        assert first["error_after"] < first["error_before"]
    assert data["verdict"] in ("missing", "nothing", "unexplained", "undecided")
    assert data["decision"].keys() >= {"alpha", "material", "rival_se", "quantile", "candidates"}
    assert sum(each["share"] for each in data["where"]) == pytest.approx(1)
    assert all(each["floor"] > 0 for each in data["where"])
    assert data["text"] == d.text


def test_numbers_that_are_not_finite_are_null():
    content = {"a": math.nan, "b": [math.inf, 1.0, np.float64(-np.inf)], "c": (np.int64(3), True)}
    assert jsonable(content) == {"a": None, "b": [None, 1.0, None], "c": [3, True]}


def hostile(d: Diagnosis) -> Diagnosis:
    """With a mechanism and logs whose names are markup."""
    fit = d.fit
    name = "<script>alert(1)</script>"
    experiments = [replace(e, name=f"{name}.csv") for e in fit.motion.experiments]
    motion = replace(fit.motion, experiments=tuple(experiments))
    mechanism = replace(fit.mechanism, name=name)
    problem = replace(fit.problem, mechanism=mechanism, motion=motion)
    return replace(d, fit=replace(fit, problem=problem))


@pytest.mark.parametrize("make", [clean, lacking], ids=lambda f: f.__name__)
def test_the_report_is_one_file_with_everything_escaped(make, tmp_path):
    d = hostile(replace(make(), verdict=make().verdict))
    d.write(tmp_path)
    page = read_page(tmp_path / "report.html")
    assert "<script>alert(1)</script>" in reading(page)
    assert "<script>alert(1)" not in (tmp_path / "report.html").read_text(encoding="utf-8")
    for title in (
        "Joint by joint" if d.verdict == "nothing" else "Where it fails",
        "Invisible in this data",
        "What to log next",
    ):
        assert title in titles(page)
    assert len(charts(page)) >= 2
    if d.verdict == "missing":
        assert f"the line: {d.best.label}" in reading(page)
        (choice,) = page.xpath("//div[@aria-label='Which candidate']")
        assert choice[0].text == f"* {d.best.label}"


def test_a_law_is_a_file_that_works(tmp_path):
    d = lawful()
    d.write(tmp_path)
    own = ident.read_user_effect(tmp_path / "law_elbow.py", "law", allow_code=True)
    fit = ident.identify(d.fit.mechanism + own(("elbow",)), d.fit.motion)
    (law,) = json.loads((tmp_path / "diagnosis.json").read_text())["laws"]
    assert fit.held_out["elbow"].relative == pytest.approx(law["error_after"], rel=0.2)
    for each in law["parameters"]:
        assert fit[f"law.elbow.{each['name']}"].unit == each["unit"]
    (curve,) = json.loads((tmp_path / "diagnosis.json").read_text())["curves"]
    head = (tmp_path / curve["file"]).read_text().splitlines()[0]
    assert head == "q.elbow,torque,lower,upper"
    assert law["formula"] in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_pictures():
    d = lacking()
    (axis,) = d.plot().axes
    named = [text.get_text() for text in axis.get_yticklabels()]
    assert named[: 1 + len(d.rivals)] == [d.best.label, *(each.label for each in d.rivals)]


@pytest.mark.parametrize("make", [lacking, lawful, loop], ids=lambda f: f.__name__)
def test_the_chart_of_candidates_has_the_order_of_their_table(make):
    d = make()
    (panel,) = d.plot().panels
    table = [row[0].strip("*= ") for row in candidate_rows(d)]
    drawn = [name.partition(" in ")[0] for name in panel.y_names]
    assert [name for name in drawn if name in table] == [name for name in table if name in drawn]


def test_errors_with_a_law_are_in_the_file_as_in_the_card():
    d = lawful()
    after = {each["joint"]: each["relative_after"] for each in d.json()["where"]}
    assert after == {bar.joint: bar.after.relative for bar in card(d).bars}
    assert after["elbow"] < 0.5 * d.fit.held_out["elbow"].relative


def test_the_card_of_a_grown_model_has_its_law_and_its_rivals():
    d, history = lawful(), grown()
    top = history_card(replace(history, diagnosis=d))
    (law,) = d.laws
    assert top.first == law.felt
    assert {bar.joint: bar.after for bar in top.bars}[law.felt] == law.after[law.felt]
    added = named(history.added[:1])
    assert f"Found: {added}" in history_card(history).line
    rivals = history.mechanism.with_effect("cable:wrist").effects[-1:]
    near = {history.added[0].label: rivals}
    steps = [replace(step, rivals_of=near if step.added else {}) for step in history.steps]
    top = history_card(replace(history, steps=tuple(steps)))
    assert f"{added} or {named(rivals)}, which this data cannot tell apart" in top.line
    assert "Fc: elbow 0.60" in top.sure


def test_a_grown_folder_is_a_mechanism_again(tmp_path):
    history = grown()
    paths = history.write(tmp_path / "grown")
    names = {path.name for path in paths}
    assert names >= {"mechanism.toml", "arm.urdf", "fit.json", "multipliers.csv"}
    assert names >= {"diagnosis.json", "report.html"}
    again = ident.load(tmp_path / "grown")
    assert [e.label for e in again.effects] == [e.label for e in history.mechanism.effects]
    assert all(not effect.values for effect in again.effects)  # found, not known
    assert again.unknown == history.mechanism.unknown
    motion = ident.complete(again, planted().log)
    fit = ident.identify(again, motion)
    for joint, error in history.fit.held_out.items():
        assert fit.held_out[joint].rms == pytest.approx(error.rms, rel=0.1)
    saved = ident.read_fit(tmp_path / "grown/fit.json", again)
    assert [e.label for e in saved.mechanism.effects] == [e.label for e in again.effects]
    data = json.loads((tmp_path / "grown/diagnosis.json").read_text(encoding="utf-8"))
    assert data["verdict"] == history.diagnosis.verdict


def test_the_mechanism_s_own_folder_is_refused():
    before = {path: path.read_bytes() for path in (ROBOTS / "arm").iterdir()}
    with pytest.raises(IdentError, match=r"holds mechanism\.toml of the mechanism itself"):
        grown().write(ROBOTS / "arm")
    assert {path: path.read_bytes() for path in (ROBOTS / "arm").iterdir()} == before
