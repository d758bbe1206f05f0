"""Small machines with short logs of known truth, of which mutants are made."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import ident
from helpers import ROBOTS
from ident import Fit, Log, Mechanism, Noise
from identification import Planted, motion_log, plant, robot

NAMES = ("arm", "five_bar", "four_bar", "slider_crank")
NOISE = (Noise("tau", 0.005, relative=True), Noise("q", 1e-5))
RATE, SECONDS = 100.0, 4.0
EFFECTS = ("viscous", "coulomb")


@dataclass(frozen=True, eq=False)
class Base:
    """A machine, a log of it with noise, and its fit.

    Attributes:
        folder: with the URDF, a mechanism.toml with the effects, run.csv and fit.json.
        planted: the truth.
        fit: from the log as it is.
    """

    name: str
    folder: Path
    planted: Planted
    fit: Fit

    @property
    def mechanism(self) -> Mechanism:
        return self.fit.mechanism

    @property
    def log(self) -> Log:
        return ident.read_log(self.folder / "run.csv")


@cache
def base(name: str, place: Path) -> Base:
    """Make the files of a machine in a folder."""
    folder = place / name
    shutil.copytree(ROBOTS / name, folder, ignore=shutil.ignore_patterns("*.csv", "*.md", "*.json"))
    mechanism = robot(name)
    with (folder / "mechanism.toml").open("a") as file:
        for kind in EFFECTS:
            mechanism = mechanism.with_effect(kind)
            for joint in mechanism.driven:
                file.write(f'\n[[effect]]\nkind = "{kind}"\njoint = "{joint}"\n')
    planted = plant(mechanism, motion_log(name, RATE, SECONDS), noise=NOISE, seed=1)
    columns = {c: x for c, x in planted.log.columns.items() if c[:2] in ("q.", "ta", "wr")}
    if name != "slider_crank":  # of which v and a are logged too
        log = Log.from_arrays("run.csv", planted.log.t, columns)
    else:
        log = planted.log
    log.write(folder / "run.csv")
    loaded = ident.load(folder)
    fit = ident.identify(loaded, ident.complete(loaded, ident.read_log(folder / "run.csv")))
    fit.write(folder / "out")
    shutil.copy(folder / "out" / "fit.json", folder / "fit.json")
    return Base(name, folder, planted, fit)
