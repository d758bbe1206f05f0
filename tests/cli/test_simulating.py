"""`ident simulate --forward` and `ident compare --simulate`."""

import json

import numpy as np
import pytest

import ident as api


def test_forward_without_a_motion(robots, tmp_path, done):
    log = tmp_path / "made.csv"
    options = ("--start", "v.crank=6", "--duration", "1", "--rate", "100", "--out", log)
    outcome = done("simulate", robots / "four_bar", "--forward", *options)
    assert "simulated four_bar: 101 samples" in outcome.out
    made = api.read_log(log)
    assert made.columns["v.crank"][0] == pytest.approx(6.0)


def test_forward_by_the_torques_of_a_log(slider, tmp_path, done):
    out, reactions = tmp_path / "made.csv", tmp_path / "reactions.csv"
    sets = [x for p, v in (("xx", 4e-3), ("yy", 4e-4), ("zz", 4e-3))
            for x in ("--set", f"rod.I{p}={v}")]  # fmt: skip
    done(
        "simulate", slider, slider / "run.csv", "--forward", *sets, "--joints", "theta",
        "--duration", "0.5", "--multipliers", reactions, "--out", out,
    )  # fmt: skip
    made, log = api.read_log(out), api.read_log(slider / "run.csv")
    theta = log.columns["q.theta"][: len(made.t)]
    np.testing.assert_allclose(made.columns["q.theta"], theta, atol=1e-8)
    assert api.read_log(reactions).columns.keys() == {"ball.x", "ball.y", "ball.z"}


def test_forward_by_a_fit_with_a_controller(robots, tmp_path, done):
    four, out, made = robots / "four_bar", tmp_path / "out", tmp_path / "made.csv"
    run = four / "run.csv"
    done("identify", four, run, "--with", "viscous", "--with", "coulomb", "--out", out)
    done(
        "simulate", four, run, "--forward", "--fit", out / "fit.json", "--control", "pd",
        "--gains", "crank=40,2", "--duration", "1", "--out", made,
    )  # fmt: skip
    assert len(api.read_log(made).t) == 251
    plot, folder = tmp_path / "motion.svg", tmp_path / "compared"
    outcome = done(
        "compare", four, made, "--fit", out / "fit.json", "--simulate", "--window", "0.25",
        "--plot", plot, "--out", folder,
    )  # fmt: skip
    assert "windows of 0.25 s, each from the measured state" in outcome.out
    said = json.loads((folder / "compare.json").read_text())
    assert said["replay"]["window"] == 0.25
    assert "Simulated against measured motion</h2>" in (folder / "report.html").read_text()
    assert plot.exists()


REFUSED = {
    "duration of an inverse": ("{run} --duration 2", ("--duration", "--forward")),
    "control of an inverse": ("{run} --control pd", ("--control", "--forward")),
    "control unknown": ("--forward --control pid", ("'pd'", "computed-torque")),
    "torque of nothing": ("--forward --control torque", ("--control torque", "MOTION")),
    "none with a motion": ("{run} --forward --control none", ("--control none", "MOTION")),
    "gains of none": ("--forward --gains 1,2", ("--gains", "pd")),
    "gains in words": ("{run} --forward --control pd --gains much", ("KP,KD",)),
    "start in words": ("--forward --start crank", ("--start crank", "q.crank=0.3")),
    "start nowhere": ("--forward --start tetha=1", ("q.tetha", "theta")),
    "no value": ("--forward --with viscous:theta", ("viscous.theta.Fv", "--set")),
    "tolerance": ("--forward --tolerance 1", ("1e-13",)),
}


@pytest.mark.parametrize(("text", "words"), REFUSED.values(), ids=REFUSED)
def test_what_is_refused(text, words, slider, refused):
    arguments = text.replace("{run}", str(slider / "run.csv")).split()
    refused(words, "simulate", slider, *arguments)


def test_a_window_needs_a_simulation(slider, refused):
    run = slider / "run.csv"
    refused(("--window", "--simulate"), "compare", slider, run, "--fit", run, "--window", "1")
