"""The verb `export`: a machine in the terms of a simulator or a controller, with what is lost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ident.display import Displayed, Progress, no_progress
from ident.errors import IdentError, MotionError
from ident.export.band import band, covariance_of, inseparable
from ident.export.laws import Lost, Translation
from ident.export.machine import Machine, check_scale, machine_of, shares_of
from ident.export.target import Job, Product, Target, target_of
from ident.files import write_all
from ident.fit.files import Saved
from ident.fit.result import Fit
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion, complete
from ident.simulate.replay import WINDOW, Replay, replay

OUTSIDE = 1e-3  # shown: [rad | m] by which a log may leave a limit without a word
SIMULATORS = {"mjcf": "MuJoCo", "drake": "Drake", "urdf": "MuJoCo"}


@dataclass(frozen=True, eq=False, repr=False)
class Export(Displayed):
    """A written machine, what of it the target holds, and what it cannot say.

    Attributes:
        target: into what.
        machine: what was written.
        translation: what is held, and what is lost.
        files: by name, the first the one that was asked for.
        folder: where they belong.
        notes: what a person should know of the numbers.
        replays: models' simulated motion against the measured one, where a log was given.
        motion: of that log.
    """

    target: Target
    machine: Machine
    translation: Translation
    files: Mapping[str, bytes]
    folder: Path
    notes: tuple[str, ...] = ()
    replays: Replay | None = None
    motion: Motion | None = None

    @property
    def simulator(self) -> str:
        """The simulator in which the target is replayed."""
        return SIMULATORS[self.target.name]

    @property
    def text(self) -> str:
        """The file that was asked for, where it is a text."""
        return next(iter(self.files.values())).decode()

    @property
    def fixed(self) -> tuple[tuple[str, str], ...]:
        """Effects that the target holds, each with the element."""
        return self.translation.fixed

    @property
    def lost(self) -> tuple[Lost, ...]:
        """What the target cannot say, with sizes."""
        return self.translation.lost

    def write(self, folder: str | Path | None = None) -> list[Path]:
        """Write the files, all or none, and return their paths.

        Raises:
            IdentError: if the folder cannot be written.
        """
        place = self.folder if folder is None else Path(folder)
        return write_all(place, dict(self.files))


def export(
    model: Fit | Saved | Mechanism,
    to: str,
    *,
    out: str | Path | None = None,
    like: str | Path | None = None,
    step: float | None = None,
    log: str | Path | Log | Motion | None = None,
    replayed: bool = False,
    values: Mapping[str, float] | None = None,
    shares: Mapping[str, float] | None = None,
    without: Sequence[str] = (),
    gravity: Sequence[float] | None = None,
    fitted: bool = True,
    window: float = WINDOW,
    progress: Progress | None = None,
    **settings: object,
) -> Export:
    """Return a mechanism or a fit in the terms of a simulator or a controller; `write()` writes it.

    Args:
        model: a fit, one read back, or a mechanism with values.
        to: mjcf, urdf, sdf, drake, usd, c, fmu, or a target of another package.
        out: the file; default: the mechanism's name in this folder.
        like: a file of one's own, of which only numbers that are different change.
        step: of the simulator [s].
        log: over whose motion losses are measured; default: the fit's, else a nominal one.
        replayed: whether the written file is run under the torques or commands of `log`.
        values: other values of parameters, by full name: the edited machine.
        shares: values as shares of the identified ones, which keep the same shares of their errors.
        without: effects that are left out, as `payload:tool`.
        gravity: another one (3,) [m/s²]. Of an edited machine a replay has the band of 95 % that
            the errors of the fit leave.
        fitted: whether numbers are fitted to the target's own laws, so that the motion is the same.
        window: of a replay [s], from one restart to the next.
        progress: called with (what is being done, share done).
        settings: of the target, as `real="float"` of c, `fmi=2` of fmu.

    Raises:
        IdentError: for a target or setting that is not there, a mechanism that it cannot hold, or a
            file that cannot be changed.
    """
    target = target_of(to)
    for name in settings:
        if name not in target.settings:
            raise IdentError(
                f"{to} has no setting '{name}'; valid: {', '.join(target.settings) or 'none'}"
            )
    if step is not None and not 0 < step < 1:
        raise IdentError(f"step {step:g} s; give seconds between 0 and 1, as 0.001")
    shares = dict(shares or {})
    for name in shares:
        if name in (values or {}):
            raise IdentError(f"'{name}' has a value and a share; give one of them")
    values = {**(values or {}), **shares_of(model, shares, values)}
    machine = machine_of(model, values, without, gravity)
    check_scale(model, machine)
    path = Path(out) if out is not None else Path(f"{machine.name}{target.suffix}")
    if like is not None:
        _check_like(target, Path(like), path)
    motion = _motion_of(model, machine.mechanism, log)
    job = Job(
        machine, motion, path, step, None if like is None else Path(like), fitted, settings,
        progress or no_progress,
    )  # fmt: skip
    product = target.write(job)
    notes = [*_substituted(machine), *product.notes, *_not_vouched(model, values, without)]
    made = Export(target, machine, product.translation, product.files, path.parent, tuple(notes))
    if not replayed:
        return made
    if motion is None:
        raise IdentError("nothing to replay; give a log")
    replays = _replays(made, motion, product, window, progress)
    made = replace(made, motion=motion, notes=(*made.notes, *_beyond_limits(machine, motion)))
    if not (values or without or gravity is not None):
        return replace(made, replays=replays)
    errors = covariance_of(model)
    if errors is None:
        notes = ["no band of the edited motion: the model has no errors; export a fit", *made.notes]
        return replace(made, replays=replays, notes=tuple(notes))
    kept = {name: abs(shares.get(name, 0.0)) for name in values}
    widths = band(machine, errors, motion, kept, window, progress)
    return replace(made, replays=replays.with_band("ident", widths))


def _check_like(target: Target, like: Path, out: Path) -> None:
    if not target.likes:
        raise IdentError(f"--like {like}: {target.name} is written anew; leave it out")
    if like.suffix.lower() not in target.likes:
        valid = " or ".join(target.likes)
        raise IdentError(f"--like {like}: {target.title} is a {valid} file; give such a one")
    if not like.is_file():
        raise IdentError(f"--like {like}: no such file; check the path")
    if out.resolve() == like.resolve():
        raise IdentError(f"--out {out}: is the file of --like, which stays; give another name")


def _motion_of(model: Fit | Saved | Mechanism, mechanism: Mechanism, log: object) -> Motion | None:
    if isinstance(log, Motion):
        return log
    if log is None:
        return model.motion if isinstance(model, Fit) else None
    assert isinstance(log, str | Path | Log)
    try:
        return complete(mechanism, log)
    except MotionError:
        return complete(mechanism, log, torques=False)


def _substituted(machine: Machine) -> list[str]:
    if not machine.substituted:
        return []
    return [
        f"{', '.join(machine.substituted)}: the identified body cannot exist; the nearest possible "
        "one is written"
    ]


def _not_vouched(
    model: Fit | Saved | Mechanism, values: Mapping[str, float], without: Sequence[str]
) -> list[str]:
    return [
        f"{edit}: the fit's log determines {', '.join(names)} only together with other parameters, "
        "so it cannot vouch for this edit; the band leaves that out"
        for edit, names in inseparable(model, values, without).items()
    ]


def _beyond_limits(machine: Machine, motion: Motion) -> list[str]:
    """Return joints that the log moves or drives beyond their limits, where simulators end."""
    notes = []
    for link in machine.links:
        joint = link.joint
        q = np.concatenate([e.q[e.usable, joint.index] for e in motion.experiments]) + link.offset
        if len(q) and (q.min() < joint.lower - OUTSIDE or q.max() > joint.upper + OUTSIDE):
            notes.append(
                f"{joint.name}: moves from {q.min():.4g} to {q.max():.4g} {joint.unit} in the log, "
                f"beyond its limits {joint.lower:.4g} and {joint.upper:.4g} {joint.unit}, where "
                "simulators stop it; correct the limits in the mechanism's file"
            )
    for i, name in enumerate(machine.mechanism.driven):
        effort = machine.mechanism.joint(name).effort
        if effort <= 0 or name in machine.mechanism.drives:
            continue
        tau = np.concatenate([e.tau[e.usable, i] for e in motion.experiments])
        tau = np.abs(tau[np.isfinite(tau)])
        if len(tau) and tau.max() > effort:
            notes.append(
                f"{name}: torques up to {tau.max():.4g} in the log, beyond its limit {effort:.4g} "
                f"{machine.mechanism.joint(name).force_unit}, to which simulators cut them; "
                "correct the effort in the mechanism's file"
            )
    return notes


def _replays(
    made: Export, motion: Motion, product: Product, window: float,
    progress: Progress | None,
) -> Replay:  # fmt: skip
    from ident.export.rollout import replayed

    machine = made.machine
    if made.target.name not in SIMULATORS:
        raise IdentError(
            f"--replay: {made.target.name} is not run here; valid: {', '.join(SIMULATORS)}"
        )
    if made.target.name == "drake":
        from ident.export.drake_run import replayed_in_drake as run
    else:
        run = replayed
    text = next(iter(product.files.values()))
    simulated = run(text, machine, motion, window)
    saved = Saved("ident", machine.mechanism, machine.point)
    own_replay = replay(saved, motion=motion, window=window, progress=progress)
    return Replay(
        {**own_replay.runs, SIMULATORS[made.target.name]: tuple(simulated)}, own_replay.window
    )


def joints_above(replays: Replay, model: str, acceptable: float) -> dict[str, float]:
    """Return joints whose motion a model misses by more than a share of the way, with the largest
    such share over logs, the largest first.
    """
    shares: dict[str, float] = {}
    for run in replays.runs[model]:
        for joint, error in run.errors.items():
            shares[joint] = max(shares.get(joint, 0.0), error.relative or 0.0)
    above = {joint: share for joint, share in shares.items() if share > acceptable}
    return dict(sorted(above.items(), key=lambda item: -item[1]))
