"""What Jupyter shows of every noun: tables of its own, whatever names it is given."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from lxml import html

import ident
from helpers import ROBOTS
from ident import Log
from ident.assess.good_enough import Answer, Reason, good_enough
from ident.diagnosis.result import errors_of
from ident.display import part
from ident.finding import Finding
from ident.fit.files import fit_json
from ident.fit.identify import Comparison
from ident.fit.values import Value
from ident.information.blocks import Error
from ident.show.card import Bar, Card
from ident.show.charts import Line
from ident.show.comparison import comparison_card, comparison_json, plot_forces
from ident.show.diagnosis import LINES, short
from ident.show.diagnosis import card as diagnosis_card
from ident.show.fit import card as fit_card
from ident.show.headline import good_enough_words
from ident.show.html import paragraph, report_page, table
from ident.show.laws import numbers
from ident.show.residual import plot_maps
from identification import motion_log, plant, robot
from pages import read_page, reading, titles

NASTY = '<script>alert("x")</script>'


@pytest.fixture(scope="module")
def nouns():
    mechanism = robot("four_bar")
    case = plant(mechanism.with_effect("viscous:crank"), motion_log("four_bar", 100.0), seed=1)
    log = Log.from_arrays(NASTY, case.log.t, dict(case.log.columns))
    mechanism = replace(mechanism, name=NASTY)
    motion = ident.complete(mechanism, log)
    fit = ident.identify(mechanism, motion, estimator="least-squares")
    diagnosis = ident.diagnose(fit)
    better = ident.identify(mechanism.with_effect("viscous:crank"), motion)
    return {
        "log": log,
        "mechanism": mechanism,
        "motion": motion,
        "fit": fit,
        "residual": ident.residual_of(fit),
        "comparison": ident.compare(fit, better),
        "diagnosis": diagnosis,
        "history": ident.grow(mechanism, motion),
        "health": diagnosis.health,
        "correlation": fit.correlation,
    }


SENTENCES = ("correlation", "health")


def test_every_noun_shows_itself_and_nothing_runs(nouns):
    for name, noun in nouns.items():
        shown = noun._repr_html_()
        tree = html.fragment_fromstring(shown, create_parent=True)
        assert not list(tree.iter("script")), name
        assert tree.text_content().strip(), name
        assert bool(list(tree.iter("table"))) == (name not in SENTENCES), name


def test_charts_show_themselves_as_pictures(nouns):
    fit, diagnosis = nouns["fit"], nouns["diagnosis"]
    charts = [fit.plot(), fit.plot_parts(), fit.plot_maps(), fit.plot_multipliers()]
    charts += [diagnosis.plot(), nouns["comparison"].plot(), nouns["history"].plot()]
    for chart in charts:
        assert chart._repr_png_().startswith(b"\x89PNG")
        assert len(chart.words) > 20


def test_a_live_chart_stands_in_a_frame_of_its_own(nouns):
    shown = nouns["fit"].plot().live()._repr_html_()
    assert shown.startswith("<iframe srcdoc=")
    (frame,) = html.fragment_fromstring(shown, create_parent=True)
    assert "Bokeh" in frame.get("srcdoc")


def test_what_is_not_there_cannot_be_drawn():
    case = plant(robot("arm"), motion_log("arm", 100.0, 4.0), seed=1)
    with pytest.raises(ident.FitError, match="has no closures"):
        case.fit().plot_multipliers()


def test_parameters_are_drawn_unit_by_unit(nouns):
    fit = nouns["fit"]
    values = {v.name: v for v in fit.parameters if v.identifiable}
    drawn = [name for panel in fit.plot_parameters().panels for name in panel.y_names]
    assert sorted(drawn) == sorted(values)
    for panel in fit.plot_parameters().panels:
        assert {f"[{values[name].unit}]" for name in panel.y_names} == {panel.x}
        prior, found = panel.marks
        assert list(prior.values) == [values[name].prior for name in panel.y_names]
        assert list(found.errors) == [1.96 * values[name].stderr for name in panel.y_names]


def test_multipliers_of_which_none_is_determined():
    """A picture that says so, still and live."""
    t, nothing = np.linspace(0.0, 1.0, 9), np.full((9, 2), np.nan)
    chart = plot_forces(("a.x", "a.y"), ("N", "N"), {"identified": (t, nothing)})
    assert chart._repr_png_().startswith(b"\x89PNG")
    assert chart.data()
    assert "none" in chart.panels[0].title


def test_a_card_has_its_errors_in_words():
    before, after = Error(2.0, 0.4, "N m"), Error(0.5, 0.1, "N m")
    bars = (Bar("a", before, after, noise=0.25), Bar("b", Error(1.0, None, "N")))
    *_, a, b = Card("x is missing", bars=bars).text()
    assert a.endswith("40 % → 10 %, noise 5 %")
    assert b.endswith("1 N")
    assert not {*b} & {*"○●│"}  # there is no share to be drawn


def test_noise_beside_a_bar_is_a_share_of_the_torque_of_the_present_log():
    """The log of the earlier fit needed four times as much torque."""
    bar = Bar("a", Error(2.0, 0.05, "N m"), Error(1.0, 0.1, "N m"), noise=1.0)
    assert bar.sizes == (0.05, 0.1, 0.1)


@pytest.fixture
def narrow(monkeypatch):
    """A terminal of 80 columns."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)


@pytest.mark.usefixtures("narrow")
def test_a_diagnosis_has_twenty_lines_in_a_narrow_terminal(nouns):
    """What the next experiment is in numbers goes first, then bars, then sentences."""
    d, sentence = nouns["diagnosis"], "A sentence of the card with eight words. " * 40
    step, how = "log a motion that shows more.", "move the crank, " + "and what is alike, " * 9
    quiet, loud = Error(0.01, 0.01, "N m"), Error(0.1, 0.1, "N m")
    bars = (Bar("a", loud, quiet), *(Bar(name, quiet) for name in "bcdefgh"))
    found = {
        count: short(
            d, Card("x", sentence[: 41 * count].strip(), bars[:n], "ident grow x", step, how=how)
        )
        for count, n in ((2, 1), (6, 6), (8, 8), (40, 8))
    }
    name = "left_arm_shoulder_pitch_actuated_joint"
    command = "ident add my_robot " + " ".join(f"coulomb:{name}_{n}" for n in range(4))
    long = Card("x", sentence + "It is sure. " + sentence, (Bar(name, loud, quiet),), command, step)
    texts = (*found.values(), d.short, short(d, long))
    assert all(-(-len(line) // 80) <= 4 for text in texts for line in text.splitlines())
    assert all(sum(-(-len(x) // 80) or 1 for x in text.split("\n")) <= LINES for text in texts)
    assert command in texts[-1]  # whole, as it is copied
    assert "Move the crank" in found[2]
    assert "Move the crank" not in found[8]
    assert all("log a motion" in text for text in found.values())
    assert "more about the next experiment, more candidates" in " ".join(found[8].split())


def test_a_card_explains_the_marks_that_it_shows():
    error = Error(1.0, 0.1, "N m")
    still, changed = Bar("elbow", error), Bar("elbow", error, error)
    assert "error: ● now" in Card("x", bars=(still,)).text()
    assert "error: ○ before, ● now" in Card("x", bars=(changed,)).text()
    assert "error: ○ before, ● now" in Card("x", bars=(still, changed)).text()
    assert "error: ● now" in Card("x", bars=(still, changed, changed), most=1).text()
    noisy = replace(still, noise=0.1)
    assert "error: ● now, │ noise alone" in Card("x", bars=(noisy,)).text()


def test_a_model_is_good_enough_where_its_error_is_noise_or_does_not_matter():
    errors = {"elbow": Error(0.1, 0.05, "N m"), "wrist": Error(0.1, 0.002, "N m")}
    assert good_enough(errors, {}).reason is Reason.UNKNOWN  # a log without noise
    noise = good_enough(errors, {"elbow": 0.1, "wrist": 0.1})
    assert (noise.answer, noise.reason) == (Answer.NOT_TESTED, Reason.NOISE)
    held = good_enough(errors, {"elbow": 0.1, "wrist": 0.1}, logs=["other.csv"])
    assert (held.answer, held.reason) == (Answer.YES, Reason.NOISE)
    assert good_enough(errors, {"elbow": 0.1, "wrist": 0.001}).reason is Reason.SMALL
    large = good_enough(errors, {"elbow": 3e-4, "wrist": 1e-4})
    assert (large.answer, large.joints, large.fits) == (Answer.NO, ("elbow",), False)
    assert "No: the error is 5 % of the torque in elbow" in good_enough_words(large)
    errors["elbow"] = replace(errors["elbow"], relative=0.01)  # it describes its own log
    small = good_enough(errors, {"elbow": 0.01, "wrist": 0.1})
    assert (small.answer, small.joints) == (Answer.NOT_TESTED, ("elbow",))
    assert good_enough(errors, {"elbow": 0.01}, logs=["other.csv"]).answer is Answer.NO


def test_an_error_that_rises_is_marked():
    card = Card("x", bars=(Bar("elbow", Error(1.0, 0.2, "N m"), Error(1.5, 0.3, "N m")),))
    *_, line = card.text()
    assert line.index("○") < line.index("●")
    assert line.endswith("20 % → 30 % (larger)")
    assert 'class="now rise"' in report_page("x", card, ()).decode()


def test_noise_is_one_number_in_every_result(nouns):
    """Of a fit, its diagnosis, its comparison and their files; with one criterion."""
    fit, d = nouns["fit"], nouns["diagnosis"]
    alone = ident.compare(fit)
    assert d.floor == fit.noise == fit_json(fit)["noise"]
    (model,) = comparison_json(alone)["models"].values()
    assert model["noise"] == fit.noise
    cards = fit_card(fit), comparison_card(alone), diagnosis_card(d)
    for card in cards:
        assert {bar.joint: bar.noise for bar in card.bars} == fit.noise
    answers = {words.split("Good enough? ")[1].split(".")[0] for words in (c.sure for c in cards)}
    assert len(answers) == 1
    assert cards[-1].then.startswith("add ")
    assert cards[-1].step.verb in ("add", "grow")


@pytest.mark.parametrize("torques", [(2.0, 100.0), (None, None)])
def test_of_several_validation_logs_the_one_with_the_largest_error_that_is_shown_counts(
    nouns, torques
):
    fit, (joint,) = nouns["fit"], nouns["fit"].train
    logs = {}
    for (name, rms), torque in zip((("a", 1.0), ("b", 3.0)), torques, strict=True):
        error = Error(rms, torque and rms / torque, "N m")
        logs[name] = {joint: error}
    floors = {"a": {joint: 1.0}, "b": {joint: 0.1}}
    (bar,) = fit_card(replace(fit, validation=logs, floors=floors)).bars
    now = bar.after or bar.before  # of logs without a motion no error before is known
    expected = (logs["a"][joint], 1.0) if torques[0] else (logs["b"][joint], 0.1)
    assert (now, bar.noise) == expected


def test_parts_of_work_follow_each_other():
    told = []
    for k in range(2):
        part(lambda what, share: told.append(share), 0.5 * k, 0.5 * (k + 1))("x", 0.5)
    assert told == [0.25, 0.75]


def test_a_name_that_leaves_most_of_the_error_is_not_sure(nouns):
    d = nouns["diagnosis"]
    best = d.candidates[0]
    joint, old = best.joint, errors_of(d.fit)[best.joint]
    assert "Not certain" not in diagnosis_card(d).sure
    for left, sure in ((0.9, False), (0.1, True)):
        after = {**best.after, joint: replace(old, rms=left * old.rms)}
        partial = replace(d, loud=(joint,), candidates=(replace(best, after=after),))
        assert ("Not certain that it is this: with it 81 %" in diagnosis_card(partial).sure) != sure


def test_a_log_that_was_not_fitted_is_named_and_torques_of_another_size_are_doubted():
    errors, floor = {"elbow": Error(0.1, 0.05, "N m")}, {"elbow": 0.1}
    held = good_enough(errors, floor, logs=["b.csv"])
    assert good_enough_words(held).startswith("Good enough on b.csv? Yes")
    doubts = (Finding("magnitude", "tau.elbow: 0.001 times what the URDF's bodies need"),)
    assert good_enough(errors, floor, doubts=doubts).reason is Reason.DOUBTFUL
    assert good_enough(errors, floor).fits
    assert not good_enough(errors, floor, doubts=doubts).fits


def test_torques_of_another_unit_are_doubted_in_the_card():
    arm = ident.load(ROBOTS / "arm").with_effect("viscous").with_effect("coulomb")
    log = ident.read_log(ROBOTS / "arm" / "run.csv")
    columns = {n: x * (1e-3 if n.startswith("tau") else 1.0) for n, x in log.columns.items()}
    scaled = Log.from_arrays("kilo.csv", log.t, columns)
    fit = ident.identify(arm, ident.complete(arm, scaled), estimator="least-squares")
    assert max(e.relative for e in fit.train.values()) < 0.01
    assert "Doubtful" in fit_card(fit).sure
    assert fit_card(fit).line.startswith("The size looks wrong of all torques")
    assert "scale" in fit_card(fit).line  # the remedy


def test_a_payload_is_a_mass_and_its_centre():
    values = {"m": (2.0, 0.01), "mx": (0.2, 0.002), "my": (-0.1, 0.001), "mz": (0.0, 0.002)}
    body = [Value(f"payload.hand.{n}", x, s, "kg", True, 0.0) for n, (x, s) in values.items()]
    words = numbers(body)
    assert words.startswith("mass 2 ± 0.01 kg")
    assert "x = 0.1 ± 0.0015" in words
    unknown = [replace(body[0], stderr=None, identifiable=False), *body[1:]]
    assert "mass" not in numbers(unknown)


def test_a_value_says_whether_the_log_determines_it():
    value = Value("lever.mz", 0.5, 0.01, "kg m", True, 0.4)
    assert repr(value) == str(value) == "lever.mz = 0.5 ± 0.01 kg m"
    unknown = replace(value, stderr=None, identifiable=False)
    assert str(unknown) == "lever.mz = 0.5 kg m, not determined by this log"


def test_effects_have_the_values_of_an_earlier_fit_as_prior(nouns):
    mechanism = nouns["mechanism"].with_effect("viscous:crank")
    fit = ident.identify(mechanism, nouns["motion"], estimator="least-squares")
    own = fit["viscous.crank.Fv"]
    assert own.prior == 0.0
    assert fit.since(fit)["viscous.crank.Fv"].prior == own.value


def test_the_framed_map_is_that_of_the_named_effects_own_signal(nouns):
    mechanism = nouns["mechanism"].with_effect("viscous:crank")
    after = ident.identify(mechanism, nouns["motion"], estimator="least-squares").residual
    models = {"without it": after.without("viscous:crank"), "with it": after}
    chart = plot_maps(Comparison(models, {}), "crank", effect="viscous:crank")
    marked = [panel.x for row in chart.rows for panel in row if panel.marked]
    assert marked == ["v [rad/s]"]


def test_the_framed_map_is_the_strongest_and_has_the_name_of_its_model(nouns):
    chart = nouns["comparison"].plot_maps("crank")
    without, better = chart.rows
    strength = {panel.title.split()[-1]: panel for panel in without if panel.title}
    assert [panel for panel in without if panel.marked] == [strength[max(strength)]]
    assert not any(panel.marked for panel in better)
    (first, _) = nouns["comparison"].residuals
    assert f"framed: v.crank ({first}, R² {max(strength)})" in chart.words


def test_options_in_words_are_not_broken():
    shown = str(paragraph("see `a --b`; --consistent (--total-mass 3) helps -- or 1--2"))
    assert '<span class="tied">--consistent</span>' in shown
    assert '(<span class="tied">--total-mass</span> 3) helps -- or 1--2' in shown
    assert shown.count("tied") == 2


def test_friction_under_load_is_drawn_over_the_load_in_both_directions():
    arm = ident.load(ROBOTS / "arm") + ident.effect("load_friction", "shoulder")
    values = {"load_friction.shoulder.mu": 0.05}
    log, _ = ident.simulate(arm, ident.read_log(ROBOTS / "arm" / "run.csv"), values=values)
    fit = ident.identify(arm, ident.complete(arm, log), estimator="least-squares")
    label, after = "load_friction:shoulder", fit.residual
    models = Comparison({"without it": after.without(label), "with it": after}, {})
    (framed,) = (
        panel
        for panel in plot_maps(models, "shoulder", effect=label).panels
        if panel.marked and panel.x.startswith("load")
    )
    forth, back = (mark for mark in framed.marks if isinstance(mark, Line))
    for line, sign in ((forth, 1), (back, -1)):
        assert np.allclose(line.y, sign * 0.05 * np.abs(line.x), rtol=0.2, atol=0.05)


def test_a_number_is_not_broken_at_the_sign_of_its_exponent():
    html = str(table([["name", "value"], ["k", "3.67321e-06 ± 1e-7"]], "Values"))
    assert 'class="tied">3.67321e-06</span>' in html


def test_a_table_that_is_folded_already_is_not_folded_again_without_a_title():
    rows = [["name", "value"], *([str(i), "1"] for i in range(40))]
    assert "40 rows" in str(table(rows, "Values"))
    assert "<summary>" not in str(table(rows, ""))


def test_where_nothing_is_unknown_a_report_has_no_parameters(nouns, tmp_path):
    nouns["fit"].write(tmp_path)
    known = ident.load(tmp_path / "identified")
    fit = ident.identify(known, ident.complete(known, nouns["fit"].motion.logs[0]))
    fit.write(tmp_path / "again")
    page = read_page(tmp_path / "again" / "report.html")
    assert "Parameters" not in titles(page)
    assert not any(bar.after for bar in fit_card(fit).bars)


def test_words_on_a_joint_have_the_error_of_the_card(nouns, tmp_path):
    fit = nouns["fit"]
    fit.write(tmp_path)
    text = reading(read_page(tmp_path / "report.html"))
    for bar in fit_card(fit).bars:
        joint, error = bar.joint, fit.held_out[bar.joint]
        assert f"{joint}: held-out error {error.rms:.3g} {error.unit}" in text
