"""Growth of identify with samples and joints, of loops with closures, of diagnose with candidates.

    python benchmarks/growth.py [--samples 5000] [--only NAME …]

Serial chains of 2 to 60 joints with viscous and Coulomb friction; four-bars one on the coupler of
the other, each three joints in the tree and one closure (a pin of five equations, of which two are
independent); and the columns and one ranking of ever more candidates beside arm6's model. The
growth from a thousand to ten million samples is that of `stream.py`. Processor time of one thread,
a new motion in each run.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import arm6
import arm7
import numpy as np

import ident

JOINTS = (2, 7, 15, 30, 60)
CLOSURES = (1, 2, 6, 16)
CANDIDATES = (10, 50, 200, 1000)
SAMPLES = 5_000
Row = dict[str, object]

LINK = (
    '<link name="{name}"><inertial><origin xyz="{x} 0.01 0.002"/><mass value="{mass}"/><inertia '
    'ixx="0.002" iyy="0.01" izz="0.011" ixy="0.0002" ixz="0.0001" iyz="0.0001"/></inertial></link>'
)
JOINT = (
    '<joint name="{name}" type="revolute"><origin xyz="{origin}"/><parent link="{parent}"/>'
    '<child link="{child}"/><axis xyz="{axis}"/>'
    '<limit lower="-7" upper="7" effort="1000" velocity="20"/></joint>'
)
PIN = """
[[closure]]
name = "pin_{i}"
kind = "revolute"
a = {{ link = "coupler_link_{i}", xyz = [0.41, 0.0, 0.0], rpy = [1.5707963267948966, 0.0, 0.0] }}
b = {{ link = "rocker_link_{i}", xyz = [0.25, 0.0, 0.0], rpy = [1.5707963267948966, 0.0, 0.0] }}
"""
START = {"crank": 0.0, "coupler": 0.609385308031, "rocker": 1.218770616062}  # [rad] of a four-bar


def chain(joints: int) -> ident.Mechanism:
    """A serial arm of so many joints, axes up and across in turn, with friction."""
    parts = ['<link name="base"/>']
    for i in range(joints):
        parts.append(LINK.format(name=f"link_{i}", x=0.05, mass=1.0 + 1.0 / (i + 1)))
        axis, parent = ("0 0 1", "0 1 0", "1 0 0")[i % 3], f"link_{i - 1}" if i else "base"
        parts.append(
            JOINT.format(name=f"joint_{i}", origin="0.1 0 0.05", parent=parent, child=f"link_{i}",
                         axis=axis)
        )  # fmt: skip
    return _loaded("".join(parts), None).with_effect("viscous").with_effect("coulomb")


def four_bars(closures: int) -> ident.Mechanism:
    """Four-bars, each on the coupler of the one before; the cranks are driven."""
    parts, pins, start, passive, bodies = ['<link name="base"/>'], [], [], [], []
    for i in range(closures):
        ground = f"coupler_link_{i - 1}" if i else "base"
        for part, parent, origin, x, mass in (
            ("crank", ground, "0 0 0", 0.02, 0.7),
            ("coupler", f"crank_link_{i}", "0.15 0 0", 0.23, 1.1),
            ("rocker", ground, "0.4 0 0", 0.12, 0.8),
        ):
            name = f"{part}_link_{i}"
            parts.append(LINK.format(name=name, x=x, mass=mass))
            parts.append(
                JOINT.format(name=f"{part}_{i}", origin=origin, parent=parent, child=name,
                             axis="0 -1 0")
            )  # fmt: skip
            start.append(f"{part}_{i} = {START[part]}")
            bodies.append(f'"{name}"')
        passive += [f'"coupler_{i}"', f'"rocker_{i}"']
        pins.append(PIN.format(i=i))
    toml = (
        f'urdf = "machine.urdf"\n[joints]\npassive = [{", ".join(passive)}]\n'
        f"start = {{ {', '.join(start)} }}\n[parameters]\nunknown = [{', '.join(bodies)}]\n"
        f"{''.join(pins)}"
    )
    return _loaded("".join(parts), toml)


def _loaded(parts: str, toml: str | None) -> ident.Mechanism:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "machine.urdf").write_text(f'<robot name="machine">{parts}</robot>')
        if toml is None:
            return ident.load(folder / "machine.urdf")
        (folder / "mechanism.toml").write_text(toml)
        return ident.load(folder)


def log_of_loops(model: ident.Mechanism, samples: int) -> ident.Log:
    """A rich motion of the cranks at 200 Hz, torques with noise of 1 %."""
    rng, t, columns = np.random.default_rng(0), np.arange(samples) / 200.0, {}
    for name in model.driven:
        w, phase = 2 * np.pi * rng.uniform(0.2, 0.8, 3)[:, None], rng.uniform(0, 6, 3)[:, None]
        columns[f"q.{name}"] = 0.3 * np.sin(w * t + phase).sum(axis=0)
        columns[f"v.{name}"] = 0.3 * (w * np.cos(w * t + phase)).sum(axis=0)
        columns[f"a.{name}"] = -0.3 * (w**2 * np.sin(w * t + phase)).sum(axis=0)
    motion = ident.Log.from_arrays("loops", t, columns)
    made, _ = ident.simulate(model, motion, noise=[ident.Noise("tau", 0.01, True)], seed=1)
    return made


def _timed(verb: Callable[[], object]) -> tuple[float, object]:
    start = time.process_time()
    made = verb()
    return time.process_time() - start, made


def joints(samples: int = SAMPLES, sizes: tuple[int, ...] = JOINTS) -> Iterator[Row]:
    """A row a chain: µs a sample of `complete` and `identify`."""
    for count in sizes:
        model = chain(count)
        yield _row("joints", count, model, arm7.log(model, samples, 0.01))


def closures(samples: int = SAMPLES, sizes: tuple[int, ...] = CLOSURES) -> Iterator[Row]:
    """A row a machine of four-bars, of a tenth of the samples."""
    for count in sizes:
        model = four_bars(count)
        yield _row("closures", count, model, log_of_loops(model, max(400, samples // 10)))


def _row(of: str, count: int, model: ident.Mechanism, log: ident.Log) -> Row:
    seconds, motion = _timed(lambda: ident.complete(model, log))
    again, fit = _timed(lambda: ident.identify(model, motion))
    n = len(log.t)
    return {
        "of": of, "count": count, "samples": n, "complete": 1e6 * seconds / n,
        "identify": 1e6 * again / n, "rank": fit.rank,
    }  # fmt: skip


def candidates(samples: int = SAMPLES, sizes: tuple[int, ...] = CANDIDATES) -> Iterator[Row]:
    """A row a number of candidates: ms of their columns, and of one ranking with its null."""
    from ident.diagnosis.candidates import Contest, candidates_of
    from ident.diagnosis.null import with_noise
    from ident.diagnosis.selection import rank

    model = arm6.mechanism()
    log = arm6.log(model, samples, arm6.HIDDEN)
    fit = ident.identify(model, ident.complete(model, log))
    every = candidates_of(fit)
    for size in sorted({min(size, len(every)) for size in sizes}):
        some = every[:: -(-len(every) // size)]
        made, contest = _timed(
            lambda some=some: Contest.of(fit, some, lambda what, share: None, curved=False)
        )
        contest = with_noise(contest)
        judged, _ = _timed(lambda contest=contest: rank(contest, curved=False))
        yield {
            "of": "candidates", "count": len(some), "samples": len(log.t),
            "columns": 1e3 * made, "ranking": 1e3 * judged,
        }  # fmt: skip


AXES = {"joints": joints, "closures": closures, "candidates": candidates}


def table(samples: int = SAMPLES, only: tuple[str, ...] = tuple(AXES)) -> list[Row]:
    """All rows: times of `complete` and `identify` in µs a sample, of candidates in ms."""
    return [row for name in only for row in AXES[name](samples)]


def main() -> None:
    parser = argparse.ArgumentParser(description="growth with joints, closures, candidates")
    parser.add_argument("--samples", type=int, default=SAMPLES)
    parser.add_argument("--only", nargs="+", choices=AXES, default=[*AXES])
    given = parser.parse_args()
    for name in given.only:
        for row in AXES[name](given.samples):
            words = (f"{k} {x:.4g}" if isinstance(x, float) else f"{k} {x}" for k, x in row.items())
            print(", ".join(words), flush=True)


if __name__ == "__main__":
    sys.exit(main())
