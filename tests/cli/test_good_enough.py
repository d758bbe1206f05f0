"""Last month's model on a new log: which joint changed, and a threshold of one's own."""

import json
import re

import numpy as np

import ident
from helpers import ROBOTS
from ident.assess.good_enough import Reason, good_enough
from ident.information.blocks import Error
from ident.show.headline import good_enough_words

ARM, RUN = ROBOTS / "arm", ROBOTS / "arm" / "run.csv"


def test_last_months_model_on_a_new_log(tmp_path, spoken):
    """In which the elbow has more friction."""
    friction, old, new = ("--with", "viscous", "--with", "coulomb"), tmp_path / "old", "new.csv"
    assert spoken("identify", ARM, RUN, *friction, "--out", old)[0] == 0
    risen = ("--set", "coulomb.elbow.Fc=1.2", "--noise", "tau=0.2%", "--out", tmp_path / new)
    assert spoken("simulate", old / "identified", RUN, *risen)[0] == 0
    fit = ("--fit", old / "fit.json")
    status, text, _ = spoken("compare", ARM, tmp_path / new, *fit)
    assert status == 0
    assert "changed since it was fitted in elbow" in " ".join(text.split())
    assert 0 < text.index("  yaw") < text.index("  elbow")  # the order of the mechanism
    _, text, _ = spoken("compare", ARM, RUN, *fit)
    assert "the error is" in " ".join(text.split())
    _, text, _ = spoken("compare", ARM, tmp_path / new, *fit, "--json")
    assert [x["changed"] for x in json.loads(text)["models"].values()] == [["elbow"]]
    status, text, _ = spoken("identify", old, tmp_path / new, "--out", tmp_path / "after")
    assert status == 0
    words = " ".join(text.split("\nerror ")[0].split())
    assert "one thing changed since " in words
    assert "dry friction in elbow (coulomb) (Fc 0.89" in words
    assert "What has changed" in (tmp_path / "after" / "report.html").read_text()
    cutoffs = [
        json.loads((folder / "fit.json").read_text())["filter"]["cutoff"]
        for folder in (old, tmp_path / "after")
    ]
    assert cutoffs[1] == cutoffs[0]  # both are filtered alike
    status, text, err = spoken("compare", ARM, tmp_path / new, *fit, "--good-enough", 1)
    assert status == 3
    words = " ".join(text.split())
    assert "Good enough on new.csv? No: " in words
    assert "in elbow, more than 1 %" in words
    assert "status 3: elbow above --good-enough 1 %" in err
    status, text, _ = spoken("compare", ARM, tmp_path / new, *fit, "--good-enough", 10)
    assert (status, "Good enough on new.csv? Yes" in text) == (0, True)


def test_another_motion_of_a_model_that_lacks_friction_is_no_change(tmp_path, spoken):
    true = ident.load(ARM).with_effect("viscous").with_effect("coulomb")
    values = {name: 0.5 for effect in true.effects for name in effect.names}
    t = np.arange(0.0, 10.0, 0.005)
    for name, speed in (("slow", 1.0), ("fast", 2.2)):
        random, q = np.random.default_rng(len(name) + int(speed)), {}
        for joint in true.driven:
            waves = ((random.uniform(0.2, 0.5), w, random.uniform(0, 6)) for w in (0.7, 1.3, 2.1))
            q[f"q.{joint}"] = sum(a * np.sin(speed * w * t + phase) for a, w, phase in waves)
        log = ident.Log.from_arrays(name, t, q)
        made, _ = ident.simulate(true, log, values=values, noise=[ident.Noise("tau", 0.003, True)])
        made.write(tmp_path / f"{name}.csv")
    out = ("--with", "viscous", "--out", tmp_path / "fit")
    assert spoken("identify", ARM, tmp_path / "slow.csv", *out)[0] == 0
    _, text, _ = spoken("compare", ARM, tmp_path / "fast.csv", "--fit", tmp_path / "fit/fit.json")
    assert "fast.csv: no sign of a change; " in " ".join(text.split())


def test_a_fit_that_is_not_good_enough(spoken):
    status, text, _ = spoken("identify", ARM, RUN, "--good-enough", 10)
    assert (status, "more than 10 %" in " ".join(text.split())) == (3, True)


def test_good_enough_beside_noise_alone(tmp_path, spoken):
    """With 0 an error is judged against noise alone, whose joints the card and the note name."""
    friction = ("--with", "viscous", "--with", "coulomb")
    status, text, err = spoken("identify", ARM, RUN, *friction, "--good-enough", 0)
    assert (status, "It fits this log" in text, "status 3" in err) == (0, True, False)
    status, _, err = spoken("identify", ARM, RUN, "--with", "viscous", "--good-enough", 0)
    assert (status, "status 3: " in err) == (3, True)
    noisy = tmp_path / "noisy.csv"
    made = ("--with", "viscous:elbow", "--set", "viscous.elbow.Fv=0.5", "--noise", "tau=30%")
    assert spoken("simulate", ARM, RUN, *made, "--out", noisy)[0] == 0
    status, text, _ = spoken("identify", ARM, noisy, "--with", "viscous:elbow", "--good-enough", 1)
    assert (status, "Good enough? No" in text) == (0, False)


def test_good_enough_names_the_log_it_was_validated_on(tmp_path, spoken):
    friction, other = ("--with", "viscous", "--with", "coulomb"), tmp_path / "other.csv"
    changed = ("--with", "coulomb:elbow", "--set", "coulomb.elbow.Fc=3")
    assert spoken("simulate", ARM, RUN, *changed, "--out", other)[0] == 0
    validated = ("--validate", other, "--good-enough", 2)
    status, _, err = spoken("identify", ARM, RUN, *friction, *validated)
    assert status == 3
    assert " of other.csv above --good-enough 2 %" in err
    status, text, err = spoken("identify", ARM, RUN, *friction, *validated, "--stream")
    assert (status, "Good enough on other.csv? No" in text) == (3, True)
    (elbow,) = (
        line for line in text.splitlines() if line.startswith("  elbow") and "noise" in line
    )
    assert "→" not in elbow  # of that log, on which portions show no model before
    assert " of other.csv above --good-enough 2 %" in err
    locked = ("--lock", "wrist", "--good-enough", 1000)
    assert spoken("identify", ARM, RUN, *friction, *locked)[0] == 0


def test_one_answer_on_every_page(tmp_path, spoken):
    """Of an exact model whose wrist turns back within noise of its speed: good enough with the
    knots that the positions ask for, and not with coarser ones.
    """
    friction, log = ("--with", "viscous", "--with", "coulomb"), tmp_path / "rough.csv"
    sizes = {"yaw": (1.2, 2), "shoulder": (1.5, 2.5), "elbow": (0.5, 0.9), "wrist": (0.02, 0.04)}
    values = [
        word
        for joint, (Fv, Fc) in sizes.items()
        for word in ("--set", f"viscous.{joint}.Fv={Fv}", "--set", f"coulomb.{joint}.Fc={Fc}")
    ]
    noise = ("--noise", "q=1e-3", "--noise", "tau=0.2%", "--columns", "q,tau", "--seed", 1)
    assert spoken("simulate", ARM, RUN, *friction, *values, *noise, "--out", log)[0] == 0
    out = ("--out", tmp_path / "fit")
    for knots, verdict in (((), "in every joint the error is "), (("--smoothing", 0.3), "No: ")):
        pages = [
            spoken("identify", ARM, log, *friction, *knots, *out)[1],
            spoken("compare", ARM, log, "--fit", tmp_path / "fit" / "fit.json", *knots)[1],
        ]
        answers = [
            re.search(r"(?:Good enough\?|It fits this log).*?\.(?= |$)", " ".join(page.split()))
            for page in pages
        ]
        first, second = (answer[0] for answer in answers if answer)
        assert first == second
        assert verdict in first or "It fits this log to " in first


def test_noise_above_the_torque_itself_is_no_yes():
    errors = {"base": Error(0.26, 0.26, "N m"), "tip": Error(0.01, 0.01, "N m")}
    hidden = good_enough(errors, {"base": 1.16, "tip": 0.01})
    assert (hidden.reason, hidden.joints) == (Reason.HIDDEN, ("base",))
    text = good_enough_words(hidden)
    assert text == "Good enough? These logs cannot show it: noise is 116 % of the torque of base."
    assert good_enough(errors, {"base": 0.25, "tip": 0.01}).fits


def test_only_reversals_are_beyond_noise():
    beyond = {"tip": Error(0.05, 0.05, "N m")}
    assert good_enough(beyond, {"tip": 0.01}, away_from_reversals={"tip": 0.01}).near_reversals
    assert not good_enough(beyond, {"tip": 0.01}, away_from_reversals={"tip": 0.05}).near_reversals
