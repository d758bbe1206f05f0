"""What a diagnosis says: each verdict, its reasons, and nothing that it does not know."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest
from diagnosed import clean, grown, lacking, lawful, loop

import ident
from helpers import ROBOTS
from ident import Health
from ident.assess.diagnosis import assess_diagnosis
from ident.diagnosis.unobservable import Invisible, Unsupported
from ident.effects.library import named
from ident.finding import Finding
from ident.fit.files import Saved
from ident.fit.values import Value
from ident.information.blocks import Error
from ident.show.card import Bar, Card
from ident.show.diagnosis import aside, certainty, short
from ident.show.diagnosis import words as text_of
from ident.show.experiment import remedy_of
from ident.show.ladder import head, history_card, rung
from ident.show.laws import numbers
from ident.show.verdict import verdict_line
from ident.text import WIDTH, listed, percent, shortlist


def bad(name: str, channel: str) -> Finding:
    return Finding(name, f"{channel}: is turned", "turn it", (channel,), 1.0, 0.5)


def test_what_is_missing_is_named_with_its_joint_value_and_certainty():
    d = lacking()
    assert d.verdict == "missing"
    assert "coulomb:elbow" in [d.best.label, *(each.label for each in d.rivals)]
    best = d.candidates[0]
    value = best.parameters[0]
    words = [d.where[0].joint, best.effect.signature, f"{value.name.rpartition('.')[2]} = ", "N m"]
    for each in [*words, *(rival.label for rival in d.rivals)]:
        assert each in d.text
    assert d.best.label in d.short


@pytest.mark.parametrize("make", [clean, lacking, loop], ids=lambda f: f.__name__)
def test_the_first_lines_are_few_and_have_the_verdict_the_errors_and_the_command(make):
    d = make()
    lines = d.short.splitlines()
    assert len(lines) <= 20
    assert max(len(x) for x in lines if not x.startswith("  ident ")) <= WIDTH
    assert "error " in lines[0]
    assert {"missing": "Missing: ", "nothing": "Nothing is missing"}.get(d.verdict, "Left: ") in (
        " ".join(" ".join(lines).split())
    )
    for joint in d.fit.motion.independent:
        assert joint in d.short
    step = assess_diagnosis(d).next
    assert (step.verb == "add") == (d.best is not None)


def test_the_last_line_names_what_is_left_out_and_only_that(monkeypatch):
    def last(steps, top):
        monkeypatch.setattr(ident.diagnosis.result.Diagnosis, "next_experiment", steps)
        return " ".join(short(d, top).rpartition("--verbose:")[2].split())

    d, top = lacking(), Card("x", "It is sure.", (), "ident grow x")
    assert "more about" not in last("Move the elbow.", top)
    assert "more about the next experiment" in last("Move the elbow. Load it.", top)
    assert "the whole verdict" not in last("Move the elbow.", top)
    long = replace(top, sure="A sentence of the card with eight words. " * 40)
    assert last("Move the elbow.", long).startswith("the whole verdict")
    assert "more candidates" in last("Move the elbow.", top)
    d = replace(d, candidates=())
    assert "more candidates" not in last("Move the elbow.", top)


def test_what_nothing_explains_gets_no_name():
    d = replace(lacking(), verdict="unexplained", laws=(), curves=())
    assert clean().verdict == "nothing"
    for text in (clean().text, text_of(d, "")):
        assert "issing is" not in text
        assert "ident add" not in text
    assert named([d.candidates[0].effect]) in text


def test_a_law_is_a_description_and_says_how_to_use_it():
    d = lawful()
    (law,) = d.laws
    assert d.verdict == "unexplained"
    text = text_of(d, "")
    assert f"--with DIR/law_elbow.py:law:{','.join(law.found.formula.joints)} --allow-code" in text
    assert law.formula in text
    assert "not yet a cause" in text


def test_health_comes_first():
    d = replace(clean(), health=Health((bad("sign", "tau.elbow"),)))
    assert text_of(d, "").startswith("Before anything: the data themselves look wrong. tau.elbow: ")
    assert "Before anything" not in clean().text


def test_rivals_in_a_loop_are_a_matter_of_leverage():
    d = loop()
    first, second = (ident.effect("viscous", joint) for joint in ("rocker", "crank"))
    found = next(each for each in d.candidates if each.effect.label == first.label)
    best = replace(found, rivals=(second,))
    text = text_of(replace(d, verdict="missing", candidates=(best,)), "")
    assert "viscous friction in rocker and crank" in text
    assert "leverage" in text
    alone = replace(lacking().candidates[0], rivals=(ident.effect("drag", "elbow"),))
    text = text_of(replace(lacking(), candidates=(alone,)), "")
    assert "leverage" not in text
    assert "They differ at other speeds, positions or loads" in text


def test_invisible_effects_of_a_kind_are_named_together():
    hidden = [Invisible(ident.effect("rotor_inertia", j), "absorbed") for j in ("yaw", "elbow")]
    text = text_of(replace(clean(), invisible=tuple(hidden)), "")
    assert "rotor inertia in elbow and yaw" in text or "rotor inertia in yaw and elbow" in text
    assert "cannot show" not in text_of(replace(clean(), invisible=()), "")


def test_effects_that_the_data_do_not_support():
    drift, spring = ident.effect("drift", "yaw"), ident.effect("spring", "elbow")
    found = (Unsupported(drift, "it is not", False), Unsupported(spring, "it is negative", True))
    text = text_of(replace(clean(), unsupported=found), "")
    assert "torque drift in yaw is idle: it is not." in text
    assert "To leave out drift:yaw and spring:elbow" in text
    assert "`mechanism.without('drift:yaw')`" in text
    assert "spring in elbow cannot be as it is: it is negative" in text


def test_an_earlier_model_that_was_incomplete_is_no_change_of_the_machine():
    d = lacking()
    then = dict(d.fit.held_out or d.fit.train)
    saved = Saved("fit.json", d.fit.mechanism, d.fit.point, errors={"held out": then})
    d = replace(d, verdict="unexplained", laws=(), fit=d.fit.since(saved))
    assert "Nothing has changed, but the earlier model was incomplete" in verdict_line(d)
    assert assess_diagnosis(d).next.verb == "grow"
    assert "elbow (" in verdict_line(d)
    less = {j: replace(e, rms=e.rms / 9, relative=(e.relative or 0) / 9) for j, e in then.items()}
    worse = replace(d, fit=d.fit.since(replace(saved, errors={"held out": less})))
    assert assess_diagnosis(worse).next.verb != "grow"


def test_the_reason_why_an_effect_is_not_named_is_said():
    d = clean()
    first, second, *_ = d.every
    both = [
        replace(each, evidence=replace(each.evidence, p=0.0, sensible=sensible, size=0.0))
        for each, sensible in ((first, True), (second, False))
    ]
    text = certainty(replace_every(d, both))
    assert f"{named([first.effect])} (too small to matter away from reversals)" in text
    assert f"{named([second.effect])} (with an impossible value)" in text


def replace_every(d, found):
    other = replace(d)
    vars(other)["every"] = tuple(found)  # a cached property
    return other


def test_the_next_experiment_comes_last():
    assert text_of(clean(), "turn it further").endswith("turn it further")


@pytest.mark.parametrize("make", [clean, lacking, loop], ids=lambda f: f.__name__)
def test_the_printed_summary_fits_and_has_all(make):
    d = make()
    printed = str(d)
    lines = [line for line in printed.splitlines() if not line.startswith("  ident ")]
    assert max(map(len, lines)) <= WIDTH
    assert {"missing": "Missing: ", "nothing": "Nothing is missing"}[d.verdict] in printed
    for joint in d.fit.motion.independent:
        assert joint in printed
    for each in d.candidates:
        assert each.effect.label in printed
    flat = " ".join(printed.split())
    assert all(" ".join(part.split()) in flat for part in d.text.split("\n\n"))
    assert "<table>" in d._repr_html_()


def test_a_ladder_prints_and_draws():
    history = grown()
    lines = str(history).splitlines()
    assert lines[2].startswith("nothing added")
    first = named(history.added[:1]).split(" in ")[0]
    assert any(line.startswith("+ ") and first in line for line in lines)
    assert lines[-1].startswith("noise alone ")
    assert max(len(x) for x in lines if not x.startswith("  ident ")) <= WIDTH
    head, *rows = history.table()
    assert head == ["effect", "yaw", "shoulder", "elbow", "wrist", "rivals"]
    assert len(rows) == len(history.steps) + 1  # and what noise alone would leave
    (axis,) = history.plot().axes
    labels = [line.get_label() for line in axis.lines]
    assert [label for label in labels if not label.startswith("_")] == head[1:5]
    assert len(labels) == 8  # each joint's noise floor
    assert len(axis.get_xticklabels()) == len(history.steps)


def test_one_kind_at_several_joints_is_one_rung_and_one_name():
    joints = [f"joint_{i}" for i in (5, 3, 4, 7)]
    rotors = tuple(ident.effect("rotor_inertia", joint) for joint in joints)
    step = replace(grown().steps[0], added=rotors)
    assert str(step).startswith("+ rotor inertia in joint_3 to ")
    assert named(rotors) == "rotor inertia in joint_3 to joint_5 and joint_7"
    assert named((*rotors, ident.effect("drag", "wrist")), "or").endswith(" or fluid drag in wrist")
    dry = [ident.effect("coulomb", joint) for joint in joints]
    assert named(dry, "or") == "dry friction in joint_5, joint_3, joint_4 or joint_7 (coulomb)"
    assert named([ident.effect("payload", "hand")]) == "payload on hand"


def test_a_rung_on_which_effects_go():
    first, *_ = grown().steps
    drift, spring = ident.effect("drift", "yaw"), ident.effect("spring", "elbow")
    assert str(first).startswith("nothing added")
    assert str(replace(first, removed=(drift,))).startswith("− torque drift in yaw ")
    several = " ".join(str(replace(first, removed=(drift, spring))).split())
    assert several.startswith("− torque drift in yaw and ")
    assert "spring in elbow" in several


def test_joints_with_long_names_are_numbered():
    joints = [f"a_rather_long_name_of_joint_{i}" for i in range(6)]
    first, *more = head(joints).splitlines()
    assert "[1] a_rather_long_name_of_joint_0" in first
    assert more[-1].split() == ["effect", *(f"[{i}]" for i in range(1, 7))]
    step = grown().steps[0]
    errors = {name: step.errors["yaw"] for name in joints}
    line = rung(replace(step, errors=errors), joints)
    assert len(line) == len(more[-1])


def test_a_name_in_the_ladder_is_whole():
    """In its column, or below it."""
    step = grown().steps[0]
    for name, below in (("j2s6s200_joint_", False), ("a_rather_long_name_of_a_joint_", True)):
        joints = [f"{name}{i}" for i in range(6)]
        errors = {joint: step.errors["yaw"] for joint in joints}
        friction = ident.effect("viscous", joints[1])
        first, *more = rung(replace(step, errors=errors, added=(friction,)), joints).splitlines()
        assert " ".join([first.split("  ")[0], *map(str.strip, more)]) == f"+ {named([friction])}"
        assert len(more) == below
        assert len(first) == len(head(joints).splitlines()[-1])


def test_an_error_without_measure_is_no_huge_percentage():
    assert percent(None) == "–"
    assert percent(0.00129) == "0.129 %"
    assert percent(1.49e6) == "over 1000 %"


def test_small_pieces():
    assert listed([]) == "none"
    assert listed(["a", "b", "c"], "or") == "a, b or c"
    assert shortlist(["a", "b", "c", "d", "e"], 2) == "a, b and 3 more"


def test_a_value_smaller_than_its_error_is_not_determined():
    known = Value("hysteresis.elbow.z0", 0.07, 0.01, "rad", True, 0.0)
    unknown = Value("hysteresis.elbow.sigma", 3.0, 290.0, "N m/rad", True, 0.0)
    text = numbers([known, unknown])
    assert "z0 = 0.07 ± 0.01 rad and" in text
    assert text.endswith("290 N m/rad (not determined)")


def test_a_body_in_a_plane_has_two_coordinates_of_its_centre():
    said = {"m": (250.0, 0.1), "mx": (500.0, 0.5), "my": (0.0, None), "mz": (-50.0, 0.3)}
    words = numbers([
        Value(f"payload.stick.{name}", value, error, "kg", error is not None, 0.0)
        for name, (value, error) in said.items()
    ])  # fmt: skip
    assert words.startswith("mass 250 ± 0.1 kg, its centre at x = 2 ± ")
    assert "z = -0.2 ± " in words
    assert "y = " not in words


def test_what_no_motion_shows_has_a_measurement_of_its_joint():
    effects = [ident.effect("encoder_offset", joint) for joint in ("joint1", "joint3")]
    assert remedy_of(effects).startswith("put joint1 and joint3 against a reference")


def test_lines_are_as_wide_as_a_narrow_terminal(monkeypatch):
    printed = lacking().short
    monkeypatch.setattr("ident.text.sys.stdout", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setenv("COLUMNS", "72")
    narrow = lacking().short
    assert max(len(x) for x in narrow.splitlines() if not x.startswith("  ident")) <= 72
    assert max(len(x) for x in printed.splitlines()) > 80  # a file has its own width
    assert set(narrow.split()) >= {*printed.split(" Fc = ")[0].split()}  # values take too much


def test_the_joint_of_what_is_named_has_a_bar():
    history = grown()
    top = history_card(history)
    last = next(step.added for step in history.steps[::-1] if step.added)
    assert top.first in {
        joint for effect in (*last, *history.diagnosis.group) for joint in effect.joints
    }
    assert [bar.joint for bar in top.bars] == list(history.fit.motion.independent)


def test_bars_are_in_the_mechanisms_order_the_loudest_where_not_all_are_shown():
    quiet, loud = Error(1.0, 0.1, "N m"), Error(9.0, 0.9, "N m")
    bars = (Bar("a", quiet, quiet, 1.0), Bar("b", loud, quiet, 1.0), Bar("c", quiet, loud, 0.5))
    assert [bar.joint for bar in Card("x", bars=bars).shown] == ["a", "b", "c"]
    assert [bar.joint for bar in Card("x", bars=bars, most=1).shown] == ["c"]
    # a line that counts one more would take the place of that one
    assert [bar.joint for bar in Card("x", bars=bars, most=2).shown] == ["a", "b", "c"]
    four = (*bars, Bar("d", quiet, quiet, 1.0))
    assert [bar.joint for bar in Card("x", bars=four, most=2).shown] == ["b", "c"]
    assert [bar.joint for bar in Card("x", bars=four, most=2, first="a").shown] == ["a", "c"]
    assert "  and 2 joints more, larger in c" in Card("x", bars=bars, most=1, first="a").text()


def test_what_lowers_no_error_is_not_among_what_is_missing_too():
    arm = ident.load(ROBOTS / "arm")
    d = ident.diagnose(ident.identify(arm, ident.complete(arm, ROBOTS / "arm" / "run.csv")))
    assert "That is not all" in " ".join(aside(d))
    strict = replace(d, decision=replace(d.decision, material=0.99))  # no error falls by as much
    assert not strict.also
    assert "That is not all" not in " ".join(aside(strict))


def test_what_is_left_at_reversals_is_said_where_nothing_is_named(monkeypatch):
    d, worse = clean(), Finding("reversals", "", "", ("elbow", "yaw"), 9.0, 4.0)
    monkeypatch.setitem(vars(d.fit), "all_findings", (worse,))
    assert "reversals" not in certainty(d)  # what is left is noise
    quiet = replace(
        d, floor={name: x / (9 if name == "elbow" else 1) for name, x in d.floor.items()}
    )
    assert "What is left in elbow is near reversals" in certainty(quiet)
