"""Many logs: one joint fit, each log beside it, those that disagree named, broken ones left out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest
from folders import FRICTION, JOINTS, arm, log_of, written
from scipy.signal import lfilter

import ident
from ident.errors import IdentError, LogError
from ident.information.blocks import Block, Information
from ident.information.estimate import estimate
from ident.information.linear import Triangle
from ident.log.read import expanded, logs_in
from ident.streams.many_logs import compare_logs, disagreements

HEAVIER = {"hand.m": 0.7638 + 0.5}  # kg; the URDF's and a load at the hand's origin
DOUBLED = {"coulomb.elbow.Fc": 1.0}  # N m, 0.5 in the others


@pytest.fixture(scope="module")
def mechanism():
    return arm()


@pytest.fixture(scope="module")
def clean(mechanism):
    return [log_of(mechanism, seed) for seed in range(6)]


def each(mechanism, logs, **options):
    """Of logs in memory."""
    motion = ident.complete(mechanism, logs)
    fit = ident.identify(mechanism, motion, estimator="least-squares", **options)
    names = {i: e.name for i, e in enumerate(motion.experiments)}
    return compare_logs(fit.problem, names, {e.name: len(e) for e in motion.experiments})


def test_logs_that_are_alike_do_not_disagree(mechanism, clean):
    found = each(mechanism, clean)
    assert found.odd == ()
    assert found.table["p_value"].min() > 0.01
    assert (found.table["error"] >= found.table["own_error"]).all()
    assert "no log disagrees" in str(found)


def test_friction_that_doubled_in_one_log_is_named_with_its_size(mechanism, clean):
    found = each(mechanism, [*clean[:5], log_of(mechanism, 5, DOUBLED)])
    assert found.odd == ("run_5.csv",)
    (row,) = found.table.filter(log="run_5.csv").to_dicts()
    assert row["p_value"] < 1e-6
    assert (row["unknown"], row["part"]) == ("coulomb.elbow.Fc", "coulomb:elbow")
    assert row["worst_joint"] == "elbow"
    assert abs(row["change"] - 0.5) < 3 * row["stderr"] < 0.01
    assert row["share"] > 0.95


def test_a_payload_in_one_log_is_found_beside_the_others(mechanism, clean):
    """It moves base parameters of all joints; the load itself is what alone explains it best."""
    found = each(mechanism, [log_of(mechanism, 7, HEAVIER), *clean[1:]])
    assert found.odd == ("run_7.csv",)
    (row,) = found.table.filter(log="run_7.csv").to_dicts()
    assert row["unknown"] == "hand.m"
    assert row["change"] == pytest.approx(0.5, abs=0.005)


def test_the_majority_is_right(mechanism, clean):
    """Two that differ from all others, and from each other."""
    logs = [log_of(mechanism, 8, DOUBLED), log_of(mechanism, 9, HEAVIER), *clean[:4]]
    found = each(mechanism, logs)
    assert found.odd == ("run_8.csv", "run_9.csv")
    assert found.notes == ()


def test_of_two_logs_nothing_says_which(mechanism, clean):
    found = each(mechanism, [clean[0], log_of(mechanism, 5, DOUBLED)])
    assert len(found.odd) == 2
    assert found.notes == ("of two logs that disagree, neither can be called the wrong one",)


def test_a_diagnosis_of_logs_that_disagree_says_so_first(mechanism, clean):
    """A load in one of two logs is no effect of the library: none acts in one log alone."""

    def diagnosed(second):
        fit = ident.identify(
            mechanism, ident.complete(mechanism, [clean[0], second]), estimator="least-squares"
        )
        return ident.diagnose(fit)

    found = diagnosed(log_of(mechanism, 7, HEAVIER))
    (finding,) = found.health.faults
    assert finding.code == "logs disagree"
    assert set(finding.where) == {"run_0.csv", "run_7.csv"}
    assert "the logs disagree" in str(found).partition("Good enough")[0]
    assert diagnosed(clean[1]).health.good


def test_friction_that_is_missing_at_two_speeds_is_no_disagreement(mechanism):
    """With constant speeds dry friction takes the place of viscous friction in each log, in the two
    together it cannot; an effect that acts in both explains that.
    """
    viscous, logs = mechanism.with_effect("viscous"), []
    values = FRICTION | {f"viscous.{joint}.Fv": 2.0 for joint in JOINTS}
    for speed in (0.3, 1.2):
        t, columns = np.arange(0, 15, 0.01), {}
        for i, joint in enumerate(JOINTS):  # waves of nearly constant speed
            w = 2 * np.pi * speed * (1 + 0.13 * i) / 1.2
            k = np.arange(1, 14, 2)
            size, angle = 2.4 / np.pi**2 / k**2 * np.sinc(k / 15), np.outer(t, k * w) + i
            columns[f"q.{joint}"] = np.cos(angle) @ size + 0.2
            columns[f"v.{joint}"] = -np.sin(angle) @ (size * k * w)
            columns[f"a.{joint}"] = -np.cos(angle) @ (size * (k * w) ** 2)
        motion = ident.Log.from_arrays(f"{speed}.csv", t, columns)
        noise = [ident.Noise("tau", 0.01, relative=True)]
        logs.append(ident.simulate(viscous, motion, values=values, noise=noise, seed=1)[0])
    fit = ident.identify(mechanism, ident.complete(mechanism, logs), estimator="least-squares")
    assert fit.health.good


def test_logs_without_noise_do_not_disagree(mechanism):
    found = each(mechanism, [log_of(mechanism, seed, noise=0.0) for seed in range(3)])
    assert found.odd == ()


def test_what_the_others_do_not_tell_is_no_disagreement(mechanism, clean):
    """Only one log moves the yaw: its friction there is nobody else's to contradict."""
    still = []
    for seed in range(3):
        log = log_of(mechanism, seed)
        t = log.t
        columns = dict(log.columns)
        for name in ("q.yaw", "v.yaw", "a.yaw"):
            columns[name] = np.zeros(len(t))
        motion = ident.Log.from_arrays(f"still_{seed}.csv", t, columns)
        values = {f"coulomb.{j}.Fc": 0.5 for j in ("yaw", "shoulder", "elbow", "wrist")}
        noise = [ident.Noise("tau", 0.02, relative=True)]
        still.append(ident.simulate(mechanism, motion, values=values, noise=noise, seed=seed)[0])
    moving = log_of(mechanism, 4, dict.fromkeys(("coulomb.yaw.Fc",), 2.0) | {
        "coulomb.shoulder.Fc": 0.5, "coulomb.elbow.Fc": 0.5, "coulomb.wrist.Fc": 0.5,
    })  # fmt: skip
    assert each(mechanism, [*still, moving]).odd == ()


def test_what_is_known_leaves_nothing_to_disagree_in(mechanism, clean):
    known = replace(ident.load(mechanism.urdf.parent), unknown=())
    found = each(known, clean[:3])
    assert found.odd == ()
    assert found.table["error"].null_count() == 0


def autoregressive(random, rho, shape):
    return lfilter([1.0], [1.0, -rho], random.normal(size=shape), axis=0)


def chances(random, logs, k, blocks, rows, rho):
    """p of logs that are alike; columns and noise are autoregressions, its size differs."""
    x, cells = random.normal(size=k), []
    sizes = random.uniform(0.3, 3.0, size=(2, k))
    for log in range(logs):
        for u in range(2):
            A = autoregressive(random, rho, (rows, k)) * sizes[u]
            b = A @ x + autoregressive(random, rho, rows) * (1 + u) * (1 + log / logs)
            for block, at in enumerate(np.array_split(np.arange(rows), blocks)):
                factor, none = Triangle.of(A[at], b[at]), Triangle.empty(k)
                three, span = (factor, none, none), (at[0], at[-1])
                cells.append(Block(log, block, u, *three, np.arange(k), (1.0, 0.0), span))
    names = tuple(f"link.{i}" for i in range(k))
    columns = SimpleNamespace(names=names, units=("",) * k, rigid=np.arange(k), effects=())
    information = Information.of(cells, k, 2)
    joint = estimate(information.totals, np.zeros(k), np.ones(2))
    found = disagreements(information, joint, columns)
    return [each.p_value for each in found.values()], any(each.clear for each in found.values())


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_chances_are_what_they_say(rho):
    """No more small ones than stated, of noise that is correlated in time too."""
    random = np.random.default_rng(3)
    made = [chances(random, 4, 8, 16, 960, rho) for _ in range(40)]
    p = np.concatenate([each for each, _ in made])
    assert np.mean(p < 0.05) < 0.05 + 2 * np.sqrt(0.05 * 0.95 / len(p))
    assert sum(flagged for _, flagged in made) <= 2  # 0.4 expected
    assert np.median(p) > 0.3


@pytest.mark.slow
def test_folders_of_clean_logs_raise_no_alarm(mechanism):
    """One in a hundred may."""
    alarms = sum(
        bool(each(mechanism, [log_of(mechanism, 100 * s + i, seconds=15) for i in range(4)]).odd)
        for s in range(1, 61)
    )
    assert alarms <= 3


@pytest.fixture(scope="module")
def folder(mechanism, clean, tmp_path_factory):
    logs = {f"run_{i}.csv": log for i, log in enumerate(clean[:5])}
    logs["run_5.csv"] = log_of(mechanism, 5, DOUBLED)
    return written(tmp_path_factory.mktemp("folder"), logs)


def spoil(folder: Path) -> list[str]:
    """Puts broken logs among the others; their names."""
    good = pl.read_csv(folder / "run_0.csv")
    good.drop("tau.elbow").write_csv(folder / "no_torque.csv")
    good.head(4).write_csv(folder / "short.csv")
    good.with_columns(pl.lit(None).cast(pl.Float64).alias("q.wrist")).write_csv(
        folder / "empty_column.csv"
    )
    (folder / "noise.csv").write_text("what, is, this\n")
    (folder / "bytes.parquet").write_bytes(b"PAR1 no, it is not")
    return ["bytes.parquet", "empty_column.csv", "no_torque.csv", "noise.csv", "short.csv"]


def test_a_folder_is_one_fit_that_names_broken_and_odd_logs(mechanism, folder, tmp_path):
    mixed = tmp_path / "mixed"
    mixed.mkdir()
    for path in folder.iterdir():
        (mixed / path.name).write_bytes(path.read_bytes())
    broken = spoil(mixed)
    found = ident.gather(mechanism, mixed)
    assert sorted(found.broken) == broken
    assert all("\n" not in why and why for why in found.broken.values())
    assert found.each.odd == ("run_5.csv",)
    logs = [ident.read_log(path) for path in sorted(folder.iterdir())]
    whole = ident.identify(mechanism, ident.complete(mechanism, logs), estimator="least-squares")
    np.testing.assert_allclose(
        found.fit.estimate.solution.beta, whole.estimate.solution.beta, rtol=1e-9
    )
    found.write(tmp_path / "out")
    table = pl.read_csv(tmp_path / "out" / "logs.csv")
    assert table.filter(pl.col("disagrees"))["log"].to_list() == ["run_5.csv"]
    assert sorted(table.drop_nulls("left_out")["log"]) == broken
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Log by log" in page
    assert "no_torque.csv: left out" in page


def test_a_folder_of_broken_logs_alone_is_an_error(mechanism, folder, tmp_path):
    (tmp_path / "a.csv").write_text("t\n")
    (tmp_path / "b.csv").write_text("t,q.yaw\n1,2\n")
    with pytest.raises(IdentError, match="none of 2 logs"):
        ident.gather(mechanism, tmp_path)


def test_which_files_are_logs(tmp_path):
    for name in ("b.csv", "a.PARQUET", ".hidden.csv", "notes.txt", "c.npz", "d.mcap"):
        (tmp_path / name).touch()
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").touch()
    (tmp_path / "inside").mkdir()
    (tmp_path / "inside" / "e.csv").touch()
    names = ["a.PARQUET", "b.csv", "bag", "c.npz", "d.mcap"]
    assert [path.name for path in logs_in(tmp_path)] == names
    given = [tmp_path / "b.csv", tmp_path, tmp_path / "inside"]
    assert [path.name for path in expanded(given)] == [
        "b.csv",
        *(n for n in names if n != "b.csv"),
        "e.csv",
    ]
    with pytest.raises(LogError, match=r"holds no log; valid: files of \.csv"):
        logs_in(written(tmp_path / "none", {}))
