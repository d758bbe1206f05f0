"""Do 95 % intervals hold the truth in logs that are hard?

    python benchmarks/hard.py [runs] [part of a case's name …] [--write]

Fifty logs of planted machines: standstill mixed in, one joint moved, tiny motions, encoders of 10
to 14 bit, 10 Hz to 20 kHz, dropouts, gaps, machines of millimetres and kilometres, coloured noise;
and, with a model that is wrong by construction, saturated torques, delays, friction that is not
modelled. Each is made and identified as by default. Printed: how many base parameters were
estimated, the share of their intervals (value ± 1.96 standard errors) that hold the truth, and
where the model is wrong, the findings on the data that say so. `--write` puts the table into
README.md.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from lxml import etree
from scipy.signal import lfilter

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import scale  # noqa: E402

import ident  # noqa: E402
from helpers import MOTIONS  # noqa: E402
from ident import Fit, Log, Mechanism  # noqa: E402
from identification import Planted, plant, robot  # noqa: E402

Series = dict[str, np.ndarray]
Z95 = 1.96  # standard errors


@dataclass(frozen=True)
class Case:
    """One hard log."""

    name: str
    robot: str
    rate: float = 250.0
    seconds: float = 10.0
    amplitude: float = 1.0  # of the usual motion
    moved: str = ""  # the one joint that moves; "": all
    pauses: float = 0.0  # share of the time at standstill
    size: float = 1.0  # of the machine, its lengths over the usual ones
    tau: float = 0.01  # noise of the torques, share of their spread
    rho: float = 0.0  # its autocorrelation from sample to sample
    q: float = 0.0  # noise of the positions, share of their spread
    bits: int = 0  # of the encoders; 0: exact
    spoil: Callable[[np.random.Generator, Log], Log] | None = None  # the last thing done to the log
    without: tuple[str, ...] = ()  # kinds of effects that the model lacks
    wrong: bool = field(default=False)  # whether the model is wrong by construction


def motion(case: Case) -> Log:
    """q, v, a of the driven joints: Fourier series, with pauses, in part, small."""
    t = np.arange(round(case.seconds * case.rate)) / case.rate
    w = 2 * np.pi / 4.0
    # s(t) is the time along the motion; its rate swings between 0 and 2 (1 − pauses) or so
    if case.pauses:
        phase = np.clip(np.mod(t, 2.0) / (2.0 * (1 - case.pauses)), 0.0, 1.0)
        T = 2.0 * (1 - case.pauses)
        x, dx, ddx = (
            phase - np.sin(2 * np.pi * phase) / (2 * np.pi),
            (1 - np.cos(2 * np.pi * phase)) / T,
            2 * np.pi * np.sin(2 * np.pi * phase) / T**2,
        )
        s, ds, dds = 2.0 * 0.55 * (np.floor(t / 2.0) + x), 1.1 * dx, 1.1 * ddx
    else:
        s, ds, dds = t, np.ones_like(t), np.zeros_like(t)
    columns: Series = {}
    for joint, (offset, turns, terms) in MOTIONS[case.robot].items():
        own = case.amplitude * (not case.moved or joint == case.moved)
        turns = 0 if case.amplitude < 1 else turns
        q, v, a = offset + turns * w * s, turns * w + 0 * s, 0 * s
        for k, sine, cosine in terms:
            sin, cos = np.sin(k * w * s), np.cos(k * w * s)
            q = q + own * (sine * sin + cosine * cos)
            v = v + own * k * w * (sine * cos - cosine * sin)
            a = a - own * (k * w) ** 2 * (sine * sin + cosine * cos)
        for c, x in zip("qva", (q, v * ds, a * ds**2 + v * dds), strict=True):
            columns[f"{c}.{joint}"] = x
    return Log.from_arrays("hard.csv", t, columns)


def machine(case: Case, place: Path) -> Mechanism:
    """The robot with friction, its lengths scaled; masses scale with the third power."""
    if case.size == 1.0:
        mechanism = robot(case.robot)
    else:
        folder = place / f"{case.robot}_{case.size:g}"
        folder.mkdir(exist_ok=True)
        source = ROOT / "robots" / case.robot
        tree = etree.parse(str(source / f"{case.robot}.urdf"))
        for element in tree.iter():
            for key, power in (("xyz", 1), ("value", 3), *((i, 5) for i in INERTIA)):
                if key in element.attrib and element.tag in ("origin", "mass", "inertia"):
                    numbers = [float(x) * case.size**power for x in element.get(key).split()]
                    element.set(key, " ".join(map(repr, numbers)))
        tree.write(str(folder / f"{case.robot}.urdf"))
        text = (source / "mechanism.toml").read_text()
        (folder / "mechanism.toml").write_text(scaled(text, case.size))
        mechanism = replace(ident.load(folder), multipliers=ident.Multipliers("free"))
    return mechanism.with_effect("viscous").with_effect("coulomb")


INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def scaled(text: str, size: float) -> str:
    """The places of closures, scaled."""
    import tomlkit

    document = tomlkit.parse(text)
    for closure in document.get("closure", []):
        for end in "ab":
            closure[end]["xyz"] = [float(x) * size for x in closure[end]["xyz"]]
    return tomlkit.dumps(document)


def noisy(case: Case, rng: np.random.Generator, clean: Log) -> Log:
    """The columns that a logger has, with the case's noise."""
    columns: Series = {}
    for name, x in clean.columns.items():
        n = len(x)
        if name.startswith("q."):
            x = x + case.q * np.std(x) * rng.standard_normal(n)
            if case.bits:
                step = 2 * np.pi / 2**case.bits
                zero = rng.uniform()
                x = step * (np.round(x / step + zero) - zero)
        elif name.startswith("tau."):
            white = rng.standard_normal(n + 2000)
            x = (
                x
                + case.tau
                * np.std(x)
                * (lfilter([np.sqrt(1 - case.rho**2)], [1, -case.rho], white)[2000:])
            )
        else:
            continue
        columns[name] = x
    log = Log.from_arrays("hard.csv", clean.t, columns)
    return case.spoil(rng, log) if case.spoil else log


def kept(log: Log, keep: np.ndarray) -> Log:
    return Log.from_arrays(log.name, log.t[keep], {k: x[keep] for k, x in log.columns.items()})


def dropouts(share: float) -> Callable[[np.random.Generator, Log], Log]:
    return lambda rng, log: Log.from_arrays(
        log.name,
        log.t,
        {k: np.where(rng.random(len(x)) < share, np.nan, x) for k, x in log.columns.items()},
    )


def gaps(count: int, seconds: float) -> Callable[[np.random.Generator, Log], Log]:
    def spoil(rng: np.random.Generator, log: Log) -> Log:
        keep = np.ones(len(log.t), dtype=bool)
        for start in rng.uniform(log.t[0], log.t[-1], count):
            keep &= (log.t < start) | (log.t > start + seconds)
        return kept(log, keep)

    return spoil


def saturated(share: float) -> Callable[[np.random.Generator, Log], Log]:
    def spoil(rng: np.random.Generator, log: Log) -> Log:
        columns = dict(log.columns)
        for name, x in columns.items():
            if name.startswith("tau."):
                limit = np.quantile(np.abs(x), 1 - share)
                columns[name] = np.clip(x, -limit, limit)
        return Log.from_arrays(log.name, log.t, columns)

    return spoil


def late(samples: int) -> Callable[[np.random.Generator, Log], Log]:
    def spoil(rng: np.random.Generator, log: Log) -> Log:
        columns = {
            k: x[:-samples] if k.startswith("tau.") else x[samples:] for k, x in log.columns.items()
        }
        return Log.from_arrays(log.name, log.t[samples:], columns)

    return spoil


def cases() -> list[Case]:
    """Fifty of them."""
    every: list[Case] = []

    def of(what: str, robots: str, **more: object) -> None:
        for name in robots.split():
            every.append(Case(f"{name}: {what}", name, **more))  # type: ignore[arg-type]

    of("30 % standstill", "arm five_bar four_bar", pauses=0.3, q=1e-5)
    of("70 % standstill", "arm five_bar four_bar", pauses=0.7, q=1e-5)
    for joint in MOTIONS["arm"]:
        of(f"only {joint} moved", "arm", moved=joint, q=1e-5)
    of("a fiftieth of the motion", "arm five_bar four_bar", amplitude=0.02, q=1e-4)
    of("a tenth of the motion", "arm five_bar four_bar slider_crank", amplitude=0.1, q=1e-4)
    of("10 bit", "arm five_bar", bits=10, seconds=20.0)
    of("12 bit", "arm five_bar four_bar", bits=12)
    of("14 bit", "arm five_bar four_bar slider_crank", bits=14)
    of("10 Hz", "arm five_bar", rate=10.0, seconds=60.0, q=1e-5)
    of("25 Hz", "arm four_bar", rate=25.0, seconds=30.0, q=1e-5)
    of("2 kHz", "arm five_bar", rate=2000.0, q=1e-4)
    of("20 kHz", "arm", rate=20000.0, seconds=4.0, q=1e-4)
    of("30 % of cells empty", "arm five_bar four_bar", spoil=dropouts(0.3), q=1e-5)
    of("ten gaps", "arm five_bar four_bar", spoil=gaps(10, 0.15), q=1e-5)
    of("millimetres", "arm five_bar four_bar", size=1e-3, q=1e-5)
    of("kilometres", "arm five_bar four_bar", size=1e3, q=1e-5)
    of("coloured noise", "arm five_bar four_bar slider_crank", rho=0.99, tau=0.02, q=1e-5)
    of("saturated torques", "arm", spoil=saturated(0.1), wrong=True)
    of("torques 3 samples late", "five_bar", spoil=late(3), wrong=True)
    of("no friction modelled", "four_bar", without=("viscous", "coulomb"), wrong=True)
    return every


def identified(case: Case, seed: int, place: Path) -> tuple[Fit, Planted]:
    """The fit of one log of a case, and the truth."""
    rng = np.random.default_rng(seed)
    planted = plant(
        machine(case, place),
        motion(case),
        frictions(case, place, seed),
        offset=0.01 if case.size == 1.0 else 0.0,
        seed=seed,
    )
    mechanism = planted.mechanism
    kept_effects = tuple(e for e in mechanism.effects if e.kind not in case.without)
    mechanism = replace(mechanism, effects=kept_effects)
    log = noisy(case, rng, planted.log)
    return ident.identify(mechanism, ident.complete(mechanism, log)), planted


def frictions(case: Case, place: Path, seed: int) -> dict[str, float]:
    """Friction that suits the machine's size: a few per cent of its torques."""
    mechanism = machine(case, place)
    bare = replace(mechanism, effects=())
    log, _ = ident.simulate(bare, motion(case))
    rng, values = np.random.default_rng(seed), {}
    for joint in mechanism.driven:
        torque = float(np.std(log.columns.get(f"tau.{joint}", np.zeros(1))))
        speed = float(np.std(log.columns.get(f"v.{joint}", np.zeros(1)))) or 1.0
        values[f"viscous.{joint}.Fv"] = rng.uniform(0.02, 0.1) * torque / speed
        values[f"coulomb.{joint}.Fc"] = rng.uniform(0.02, 0.1) * torque
    return values


def covered(fit: Fit, planted: Planted) -> np.ndarray:
    """|value − truth| / standard error of every base parameter."""
    off = np.abs(fit.estimate.solution.beta - planted.base(fit))
    return off / np.array([value.stderr for value in fit.base_parameters])


def main() -> None:
    words = [word for word in sys.argv[1:] if word != "--write"]
    runs = int(words.pop(0)) if words and words[0].isdigit() else 1
    chosen = [c for c in cases() if not words or any(word in c.name for word in words)]
    print(f"{len(chosen)} cases, {runs} logs each\n{'case':38s} parameters  held  covered")
    total: list[np.ndarray] = []
    rows: list[dict[str, object]] = []
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as scrap:
        for case in chosen:
            z, held, said = [], 0, ""
            for seed in range(runs):
                try:
                    fit, planted = identified(case, seed, Path(scrap))
                except ident.IdentError as error:
                    said = f"refused: {error}"
                    continue
                z.append(covered(fit, planted))
                held += int(fit.estimate.fixed.sum())
                if case.wrong:
                    codes = [x.code for x in fit.all_findings if x.code != "note"]
                    said = said or ", ".join(dict.fromkeys(codes))
            every = np.concatenate(z) if z else np.zeros(0)
            if not case.wrong:
                total.append(every)
            rows.append(row(case.name, every, held, said))
            print(f"{case.name:38s} {len(every):10d} {held:5d}  {rows[-1]['covered']}  {said}",
                  flush=True)  # fmt: skip
    rows.append(row("all of a right model", np.concatenate(total), "", ""))
    print(rows[-1])
    if "--write" in sys.argv:
        took = (time.perf_counter() - start) / 60
        text = f"{scale.markdown(rows)}\n\n`python benchmarks/hard.py {runs}`, {took:.1f} min.\n"
        scale.put("hard", text)


def row(name: str, z: np.ndarray, held: object, said: str) -> dict[str, object]:
    share = f"{100 * np.mean(z < Z95):.1f} %" if len(z) else "–"
    return {"case": name, "parameters": len(z), "held": held, "covered": share, "said": said}


if __name__ == "__main__":
    main()
