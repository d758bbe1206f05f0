"""What a diagnosis says: each verdict, its reasons, and nothing that it does not know."""

from __future__ import annotations

from dataclasses import replace

import pytest
from diagnosed import clean, grown, lacking, lawful, loop

import ident
from ident import Health
from ident.diagnosis.unobservable import Invisible, Unsupported
from ident.fit.findings import Finding
from ident.fit.values import Value
from ident.show.diagnosis import sure
from ident.show.diagnosis import words as text_of
from ident.show.html import NOISY, named
from ident.show.ladder import head, rung
from ident.show.laws import numbers
from ident.text import WIDTH, listed, percent, some


def bad(name: str, channel: str) -> Finding:
    return Finding(name, f"{channel}: is turned", "turn it", (channel,), 1.0, 0.5)


def test_what_is_missing_is_named_with_its_joint_value_and_certainty():
    d = lacking()
    assert d.verdict == "missing"
    assert "coulomb:elbow" in [d.best.label, *(each.label for each in d.rivals)]
    text = d.text
    best = d.candidates[0]
    for words in (
        "fails in elbow",
        f"{d.best.label} (",
        best.effect.signature,
        f"arm {d.best.label}`",
        "That something is missing here: ",
        "logs in which nothing is missing would show as much",
        "N m",
    ):
        assert words in text
    value = best.parameters[0]
    assert f"{value.name.rpartition('.')[2]} = " in text
    for rival in d.rivals:
        assert rival.label in text


def test_it_says_where_nothing_but_noise_is_left():
    d = lacking()
    *_, quiet = d.text.partition(" nothing but noise is left")[0].rpartition(" In ")
    errors = d.fit.held_out
    for joint, floor in d.floor.items():
        assert (joint in quiet) == (errors[joint].rms < NOISY * floor)


@pytest.mark.parametrize("make", [clean, lacking, loop], ids=lambda f: f.__name__)
def test_the_first_lines_are_few_and_have_the_verdict_the_errors_and_the_command(make):
    d = make()
    lines = d.short.splitlines()
    assert len(lines) <= 20
    assert max(len(x) for x in lines if not x.startswith("  ident ")) <= WIDTH
    assert d.verdict in lines[0]
    for joint in d.fit.motion.independent:
        assert joint in d.short
    assert ("ident add " in d.short) == (d.best is not None)


def test_a_clean_log_gets_no_name():
    d = clean()
    assert d.verdict == "nothing"
    assert d.text.startswith("Nothing is missing that this data could show")
    assert "How small an effect could still hide" in d.text
    assert "Missing is" not in d.text
    for joint, floor in d.floor.items():
        assert f"{joint} " in d.text
        assert f"{floor:.2g}" in d.text


def test_what_nothing_explains_gets_no_name_either():
    d = replace(lacking(), verdict="unexplained", laws=(), curves=())
    text = text_of(d, "")
    assert "nothing in the library explains it, so no name is given" in text
    assert "Missing is" not in text
    assert "ident add" not in text
    assert "effects were tried" in text
    assert d.candidates[0].effect.label in text
    assert "No short formula" in text


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
    assert "could as well be viscous:crank" in text
    assert "leverage" in text
    assert "no proof of the cause" in text
    assert "against the signals of rocker" in text


def test_rivals_at_one_joint_are_no_matter_of_leverage():
    d = lacking()
    best = replace(d.candidates[0], rivals=(ident.effect("drag", "elbow"),))
    text = text_of(replace(d, candidates=(best,)), "")
    assert "leverage" not in text
    assert "at the same place" in text


def test_invisible_effects_are_grouped():
    absorbed = [
        Invisible(ident.effect("rotor_inertia", joint), f"absorbed: same columns as {link}.Lzz")
        for joint, link in (("yaw", "turret"), ("elbow", "forearm"))
    ]
    payload = [
        Invisible(ident.effect("payload", link), "absorbed: same columns as a.m, b.m, c.m")
        for link in ("a", "b", "c", "d", "e", "f")
    ]
    tilt = [Invisible(ident.effect("gravity_tilt"), "no torque changes with it: as it is")]
    text = text_of(replace(clean(), invisible=(*absorbed, *payload, *tilt)), "")
    assert "rotor_inertia of yaw (turret.Lzz) and elbow (forearm.Lzz)" in text
    assert "payload of a, b, c, d and 2 more" in text
    assert "Of gravity_tilt: no torque changes with it" in text
    assert "says nothing about" not in text_of(replace(clean(), invisible=()), "")


def test_effects_that_the_data_do_not_support():
    drift, spring = ident.effect("drift", "yaw"), ident.effect("spring", "elbow")
    found = (Unsupported(drift, "it is not", False), Unsupported(spring, "it is negative", True))
    text = text_of(replace(clean(), unsupported=found), "")
    assert "not supported by this data: drift:yaw: it is not. Leave it out" in text
    assert "mechanism.without('drift:yaw')" in text
    assert "spring:elbow cannot be as it is: it is negative." in text


def test_the_next_experiment_comes_last():
    assert text_of(clean(), "turn it further").endswith("Next experiment: turn it further")


@pytest.mark.parametrize("make", [clean, lacking, loop], ids=lambda f: f.__name__)
def test_the_printed_summary_fits_and_has_all(make):
    d = make()
    printed = str(d)
    lines = [line for line in printed.splitlines() if not line.startswith("  ident ")]
    assert max(map(len, lines)) <= WIDTH
    assert d.verdict in printed
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
    assert lines[2].startswith("as given")
    assert any(line.startswith("+ ") and history.added[0].kind in line for line in lines)
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
    assert str(step).startswith("+ rotor_inertia in joint_3 to ")
    assert named(rotors) == "rotor_inertia in joint_3 to joint_5 and joint_7"
    assert named((*rotors, ident.effect("drag", "wrist")), "or").endswith(" or drag:wrist")


def test_a_rung_on_which_effects_go():
    first, *_ = grown().steps
    drift, spring = ident.effect("drift", "yaw"), ident.effect("spring", "elbow")
    assert str(first).startswith("as given")
    assert str(replace(first, removed=(drift,))).startswith("− drift:yaw ")
    several = str(replace(first, removed=(drift, spring))).splitlines()
    assert several[0].startswith("− 2 effects ")
    assert several[1].strip() == "without drift:yaw and spring:elbow: superfluous now"


def test_joints_with_long_names_are_numbered():
    joints = [f"a_rather_long_name_of_joint_{i}" for i in range(6)]
    first, *more = head(joints).splitlines()
    assert "[1] a_rather_long_name_of_joint_0" in first
    assert more[-1].split() == ["effect", *(f"[{i}]" for i in range(1, 7))]
    step = grown().steps[0]
    errors = {name: step.errors["yaw"] for name in joints}
    line = rung(replace(step, errors=errors), joints)
    assert len(line) == len(more[-1])


def test_an_error_without_measure_is_no_huge_percentage():
    assert percent(None) == "–"
    assert percent(0.00129) == "0.129 %"
    assert percent(1.49e6) == "over 1000 %"


def test_small_pieces():
    assert listed([]) == "none"
    assert listed(["a", "b", "c"], "or") == "a, b or c"
    assert some(["a", "b", "c", "d", "e"], 2) == "a, b and 3 more"
    assert [sure(z) for z in (20, 5, 3, 2.1)] == [
        "beyond doubt",
        "very sure",
        "sure",
        "fairly sure",
    ]


def test_a_value_smaller_than_its_error_is_not_determined():
    known = Value("hysteresis.elbow.z0", 0.07, 0.01, "rad", True, 0.0)
    unknown = Value("hysteresis.elbow.sigma", 3.0, 290.0, "N m/rad", True, 0.0)
    text = numbers([known, unknown])
    assert "z0 = 0.07 ± 0.01 rad and" in text
    assert text.endswith("290 N m/rad (not determined)")
