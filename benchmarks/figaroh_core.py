"""Regressor, base parameters and least squares: figaroh's core against this library's.

python benchmarks/figaroh_core.py [10000 50000]

A serial arm of seven joints with viscous and Coulomb friction; both get the same arrays q, v, a, τ,
use every row at full rate and weigh all alike. figaroh's core is what its `solve` does without
decimation: `build_regressor_basic`, `get_index_eliminate` and `build_regressor_reduced`, then
`QRDecomposer.double_decomposition` and the predicted torque; its cheaper `decompose("pivoting")`
stands beside it. Here it is rows, factors, `reveal` and `solve`, as `identify` does it; and all of
`identify`, which adds weights, held-out errors and standard errors. `plain` is what a user would
write: a loop over Pinocchio's regressor and normal equations in pieces. Every run has a new motion,
so that nothing is kept from the one before.

The peer runs in a Python that has it: this one, or the one that FIGAROH_PYTHON names, or a virtual
environment `figvenv` beside the checkout:

    python3 -m venv ../figvenv && ../figvenv/bin/pip install figaroh==1.0.2

BLAS on one thread; each in a process of its own, processor time, the best of some runs.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import importlib.util
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

SIZES = (10_000, 50_000)
REPEAT = 4
HOW = (
    "figaroh 1.0.2 is not to be found: python3 -m venv ../figvenv && ../figvenv/bin/pip install "
    "figaroh==1.0.2, or name a Python that has it in FIGAROH_PYTHON"
)


def table(sizes: tuple[int, ...] = SIZES) -> list[dict[str, object]]:
    """One row a size and method; `ratio` is figaroh's own path over it."""
    python = peer()
    found = []
    for samples in sizes:
        with tempfile.TemporaryDirectory() as folder:
            _run(sys.executable, "--make", str(samples), folder)
            own = [
                _run(sys.executable, f"--{kind}", folder) for kind in ("core", "identify", "plain")
            ]
            methods = ("double", "pivoting") if python else ()
            theirs = [_run(python, f"--{kind}", folder) for kind in methods]
            other = "double" if python else "plain"
            tau = {kind: np.load(Path(folder) / f"{kind}.npy") for kind in ("core", other)}
            largest = np.abs(tau[other]).max()
            apart = float(np.abs(tau["core"] - tau[other]).max() / largest)
        for row in [*own, *theirs]:
            slower = float([*theirs, own[-1]][0]["us"]) / float(row["us"])
            found.append({"samples": samples, **row, "ratio": slower, "apart": apart})
    return found


def peer() -> str:
    """A Python that has figaroh; none where it is not to be found."""
    beside = Path(__file__).resolve().parents[2] / "figvenv" / "bin" / "python"
    if importlib.util.find_spec("figaroh"):
        return sys.executable
    named = os.environ.get("FIGAROH_PYTHON") or (str(beside) if beside.exists() else "")
    if not named:
        sys.stderr.write(f"{HOW}\n")
    return named


def make(samples: int, folder: Path) -> None:
    """Writes the arm and arrays of a rich motion with 1 % of noise on the torques."""
    import arm7

    log = arm7.log(arm7.mechanism(), samples, 0.01)
    joints = arm7.mechanism().driven
    arrays = {c: np.stack([log.columns[f"{c}.{j}"] for j in joints], 1) for c in ("q", "v", "a")}
    tau = np.stack([log.columns[f"tau.{j}"] for j in joints], axis=1)
    np.savez(folder / "arrays.npz", t=log.t, tau=tau, **arrays)
    (folder / "arm7.urdf").write_text(arm7.urdf())


def ours(folder: Path, whole: bool) -> dict[str, object]:
    """This library, on a motion that is the arrays as they are."""
    import arm7

    import ident
    from ident.equations.problem import Problem
    from ident.equations.rows import Scene, rows
    from ident.equations.unknowns import Columns, Point
    from ident.information.estimate import rank_revealing, solve
    from ident.information.linear import Triangle

    mechanism, arrays = arm7.mechanism(), np.load(folder / "arrays.npz")
    columns = {
        f"{c}.{joint}": arrays[c][:, i]
        for i, joint in enumerate(mechanism.driven)
        for c in ("q", "v", "a", "tau")
    }
    log = ident.Log.from_arrays("arm7", arrays["t"], columns)
    motion = ident.complete(mechanism, log, cutoff=None, smoothing=None)
    (e,) = motion.experiments
    # figaroh uses rows at standstill too
    e = replace(e, still=np.full(len(mechanism.joints), 1e-12))
    motion = replace(motion, experiments=(e,))
    assert all(np.array_equal(getattr(e, c), arrays[c]) for c in ("q", "v", "a", "tau"))

    def anew() -> ident.Motion:
        """The motion with nothing kept from the run before."""
        return replace(motion, experiments=(replace(e),))

    def core() -> tuple[np.ndarray, int, float, int]:
        regression = Problem.of(mechanism, anew(), Point.prior(mechanism))
        total = Triangle.merge(regression.information.totals)
        base = rank_revealing(total)
        x = solve(total, base, regression.prior).x
        return x, base.rank, base.condition_number, total.rows

    def identify() -> tuple[np.ndarray, int, float, int]:
        fit = ident.identify(mechanism, anew())
        return fit.estimate.solution.x, fit.rank, fit.condition_number, fit.estimate.triangle.rows

    us, (x, rank, condition, count) = best(identify if whole else core, len(e))
    memory = _memory()
    scene = Scene.of(mechanism, Columns.of(mechanism), e)
    name = "identify" if whole else "core"
    np.save(folder / f"{name}.npy", np.concatenate([each.A @ x for each in rows(scene, None)]))
    return _row("all of identify" if whole else "ident", us, rank, condition, count, memory)


def plain(folder: Path) -> dict[str, object]:
    """What a user would write: Pinocchio's regressor, sample by sample, normal equations, NumPy."""
    import pinocchio as pin

    arrays, model = np.load(folder / "arrays.npz"), pin.buildModelFromUrdf(folder / "arm7.urdf")
    q, v, a, tau = (arrays[name] for name in ("q", "v", "a", "tau"))
    data, nv, bodies = model.createData(), model.nv, 10 * (model.njoints - 1)
    piece = 500

    def rows(start: int) -> np.ndarray:
        stop = min(start + piece, len(q))
        A = np.zeros((stop - start, nv, bodies + 2 * nv))
        for i in range(start, stop):
            A[i - start, :, :bodies] = pin.computeJointTorqueRegressor(
                model, data, q[i], v[i], a[i]
            )
            A[i - start, range(nv), range(bodies, bodies + nv)] = v[i]
            A[i - start, range(nv), range(bodies + nv, bodies + 2 * nv)] = np.sign(v[i])
        return A

    def core() -> tuple[np.ndarray, np.ndarray]:
        H, g = np.zeros((bodies + 2 * nv,) * 2), np.zeros(bodies + 2 * nv)
        for start in range(0, len(q), piece):
            A = rows(start).reshape(-1, bodies + 2 * nv)
            H += A.T @ A
            g += A.T @ tau[start : start + piece].ravel()
        size = np.sqrt(np.maximum(np.diag(H), 1e-300))
        x, _, rank, _ = np.linalg.lstsq(H / np.outer(size, size), g / size, rcond=1e-10)
        return x / size, rank

    us, (x, rank) = best(core, len(q))
    memory = _memory()
    np.save(folder / "plain.npy", np.concatenate([rows(s) @ x for s in range(0, len(q), piece)]))
    return _row("plain Pinocchio, 20 lines", us, int(rank), float("nan"), len(q) * nv, memory)


def theirs(folder: Path, method: str) -> dict[str, object]:
    """figaroh on the arrays; in its Python."""
    import logging
    import warnings

    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    from figaroh.identification import parameter
    from figaroh.tools import regressor
    from figaroh.tools.qrdecomposition import QRDecomposer
    from figaroh.tools.robot import Robot

    robot, arrays = Robot(str(folder / "arm7.urdf"), str(folder)), np.load(folder / "arrays.npz")
    n, nv = arrays["q"].shape
    config = {"has_friction": True, "is_joint_torques": True, "act_idxv": list(range(nv))}
    config |= {"fv": [0.0] * nv, "fs": [0.0] * nv}
    named = parameter.get_standard_parameters(robot.model, config)
    named |= parameter.add_standard_additional_parameters(robot.model, config)

    def core() -> tuple[np.ndarray, np.ndarray]:
        W = regressor.build_regressor_basic(robot, arrays["q"], arrays["v"], arrays["a"], config)
        out, left = regressor.get_index_eliminate(W, named, tol_e=1e-3)
        W, tau = regressor.build_regressor_reduced(W, out), arrays["tau"].T.flatten()
        decomposer = QRDecomposer(tolerance=1e-6)
        if method == "double":
            base, _, _, phi, _ = decomposer.double_decomposition(tau, W, left, named)
        else:
            found = decomposer.decompose(W, left, tau, method=method)
            base, phi = found.W_b, found.phi_b
        return base, base @ phi

    us, (base, predicted) = best(core, n)
    memory = _memory()
    condition = float(np.linalg.cond(base / np.linalg.norm(base, axis=0)))
    np.save(folder / f"{method}.npy", predicted.reshape(nv, n).T)
    return _row(f"figaroh, {method} QR", us, base.shape[1], condition, len(base), memory)


def best(run: Callable[[], tuple], samples: int) -> tuple[float, tuple]:
    """µs a sample and what it returned."""
    seconds = []
    for _ in range(REPEAT if samples < 20_000 else 2):
        start = time.process_time()  # others may use the machine
        found = run()
        seconds.append(time.process_time() - start)
    return 1e6 * min(seconds) / samples, found


def _row(
    who: str, us: float, rank: int, condition: float, count: int, memory: float
) -> dict[str, object]:
    return {"who": who, "us": us, "rank": rank, "condition": condition, "rows": count, "GB": memory}


def _memory() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # GB


def _run(python: str, *arguments: str) -> dict[str, object]:
    done = subprocess.run(
        [python, __file__, *arguments], stdout=subprocess.PIPE, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1]) if done.stdout else {}


def show(sizes: tuple[int, ...]) -> None:
    print("µs a sample; ratio: figaroh's own path over it; condition: of unit columns")
    head = ("samples", "who", "us", "ratio", "rank", "condition", "rows", "GB")
    print(("{:>8} {:22}" + "{:>10}" * 6).format(*head))
    for row in table(sizes):
        print(
            f"{row['samples']:>8} {row['who']:22}{row['us']:10.1f}{row['ratio']:10.1f}"
            f"{row['rank']:10}{row['condition']:10.1f}{row['rows']:10}{row['GB']:10.2f}"
        )
        apart = row["apart"]
    print(f"largest difference of the two predictions, of the largest torque: {apart:.1e}")


def main() -> None:
    kind, *others = sys.argv[1:] or [""]
    if kind == "--make":
        make(int(others[0]), Path(others[1]))
    elif kind in ("--core", "--identify"):
        print(json.dumps(ours(Path(others[0]), kind == "--identify")))
    elif kind == "--plain":
        print(json.dumps(plain(Path(others[0]))))
    elif kind in ("--double", "--pivoting"):
        print(json.dumps(theirs(Path(others[0]), kind.strip("-"))))
    else:
        show(tuple(map(int, sys.argv[1:])) or SIZES)


if __name__ == "__main__":
    main()
