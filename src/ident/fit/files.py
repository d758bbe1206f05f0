"""Files of a fit: fit.json, multipliers.csv, identified.urdf; fit.json read back."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin

from ident.display import render
from ident.effects import KINDS, PER_LOG, Effect, log_word, read_user_effect
from ident.effects import create as create_effect
from ident.equations.unknowns import Columns, Point
from ident.errors import FitError, MechanismError, missing_file, one_of
from ident.files import json_bytes, regular, write_all
from ident.fit.findings import LEAST_MASS, bodies_with_unknowns
from ident.fit.prediction import Reactions
from ident.fit.residual import Residual, residual_of
from ident.fit.result import Fit
from ident.fit.shapes import initial
from ident.fit.values import ALPHA, BaseValue, Changes, Value
from ident.information.blocks import Error
from ident.lazy import lazy
from ident.mechanism.load import source_of
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import Covariance, fixed_parameters, pseudo_inertia
from ident.mechanism.urdf import with_inertials
from ident.motion import Motion
from ident.request import PYTHON, Request

if TYPE_CHECKING:
    import polars as pl
else:
    pl = lazy("polars")

SCHEMA = "ident.fit/1"
LEAST_SHARE = 1e-3  # shown: of a variance, from which a cause is in its budget


def write_fit(
    fit: Fit,
    folder: str | Path,
    reactions: Reactions | None = None,
    multipliers: Iterable[bytes] | None = None,
    more: Mapping[str, bytes] | None = None,
    sections: Sequence[Any] = (),
    request: Request = PYTHON,
) -> list[Path]:
    """Write fit.json, multipliers.csv, identified.urdf, report.html and the folder identified/.

    Args:
        fit: what to write.
        folder: made if it is missing.
        reactions: known ones, which the report draws beside the multipliers.
        multipliers: pieces of multipliers.csv, where the fit's motion is an excerpt.
        more: further files by name; sections: after the errors in the report.
        request: of which the fit is the answer, for the report.

    Returns:
        The files written, all of them or none.

    Raises:
        IdentError: if the folder cannot be written.
        FitError: if a body's identified inertia cannot be stated in a URDF.
    """
    urdf, exact = (identified_urdf(fit, possible=item) for item in (True, False))
    files: dict[str, bytes | Iterable[bytes]] = {
        "fit.json": json_bytes(fit_json(fit)),
        "multipliers.csv": multipliers or multipliers_csv(fit),
        "identified.urdf": urdf,
        "report.html": render(fit, "report", reactions, sections, request),
        **dict(own_files(fit).values()),
        **(more or {}),
    }
    return write_all(Path(folder), files | identified_files(fit, exact))


def identified_files(fit: Fit, urdf: bytes) -> dict[str, bytes]:
    """Return the files of identified/, in which everything is known at its value; with the URDF."""
    from ident.mechanism.write import folder_files  # TOML Kit takes 0.02 s to import

    known = [
        (effect, {u.name: float(v) for u, v in zip(effect.parameters, values, strict=True)})
        for effect, values in fit.effect_solution
    ]
    # a base parameter's error is that of its independent parameter; regrouped ones stay
    names = tuple(fit.columns.names[i] for i in fit.estimate.base.independent)
    errors = fit.known_errors
    if names and np.isfinite(fit.noise_covariance).all():  # for other logs of the same sensors
        errors_of_fit = Covariance(names, fit.noise_covariance)
        errors = errors_of_fit if errors is None else errors_of_fit + errors
    inside = folder_files(fit.mechanism, urdf, known, [], fit.found, errors)
    return {f"identified/{name}": x for name, x in inside.items()}


def own_files(fit: Fit) -> dict[str, tuple[str, bytes]]:
    """Return name and content of the files that define effects outside of the library, by label."""
    values, files = fit.found, dict[str, tuple[str, bytes]]()
    for effect in fit.mechanism.effects:
        source = None if effect.kind in KINDS else effect.source_file(values[effect.label])
        if source is not None:
            taken = dict(files.values()).get(source[0], source[1]) != source[1]
            files[effect.label] = (f"{effect.kind}_{source[0]}" if taken else source[0], source[1])
    return files


def write_urdf(fit: Fit, path: str | Path) -> Path:
    """Write identified.urdf alone; FitError if an inertia cannot be stated in a URDF."""
    path = Path(path)
    if path.suffix.lower() not in (".urdf", ".xml"):
        raise FitError(f"{path}: give a name that ends in .urdf")
    return write_all(path.parent, {path.name: identified_urdf(fit)})[0]


def multipliers_csv(fit: Fit) -> bytes:
    """Return `t` and one column a multiplier, empty where it is not determined, no rows of a tree;
    several logs stand one below the other with a column `log`.
    """
    names = fit.mechanism.kinematics.multipliers
    if not names:
        return b"t\n"
    several = len(fit.motion.experiments) > 1
    both = zip(fit.motion.experiments, fit.multipliers, strict=True)
    return b"".join(
        multipliers_rows(names, t, values, e.name if several else None, header=not number)
        for number, (e, (t, values)) in enumerate(both)
    )


def multipliers_rows(
    names: Sequence[str], t: np.ndarray, values: np.ndarray, log: str | None, header: bool
) -> bytes:
    """Return rows of multipliers.csv: t (n,) [s] and values (n, m); `log`: name, of several."""
    columns: dict[str, Any] = {"t": t, **dict(zip(names, values.T, strict=True))}
    if log is not None:
        columns["log"] = [log] * len(t)
    rows = pl.DataFrame(columns).fill_nan(None)
    return rows.write_csv(include_header=header).encode()


def fit_json(fit: Fit) -> dict[str, Any]:
    """Return the content of fit.json."""
    kinematics, multipliers = fit.mechanism.kinematics, fit.mechanism.multipliers
    band, files = fit.motion.band, own_files(fit)
    return {
        "schema": SCHEMA,
        "mechanism": fit.mechanism.name,
        "logs": list(fit.motion.names),
        "samples": fit.motion.samples,
        "rows": fit.rows,
        "parameters": [_entry(value, fit) for value in fit.parameters],
        "base_parameters": [_entry(value, fit) for value in fit.base_parameters],
        "effects": [
            {
                "kind": values.effect.kind,
                "joint": ",".join(values.effect.joints),
                **({"signal": values.effect.signal} if values.effect.signal else {}),
                **({"log": values.effect.log} if values.effect.log else {}),
                **({"file": files[values.effect.label][0]} if values.effect.label in files else {}),
                "settings": {name: values.effect.setting(name) for name in values.effect.settings},
                "parameters": [_entry(value, fit) for value in values.parameters],
            }
            for values in fit.effects
        ],
        "multipliers": {
            "names": list(kinematics.multipliers),
            "unit": list(kinematics.units),
            "basis": multipliers.basis,
            "spacing": multipliers.spacing,
            "file": "multipliers.csv",
            "stderr": fit.multiplier_errors.by_values.tolist(),
            "by_priors": fit.multiplier_errors.by_priors.tolist(),
            "rest_on": dict(fit.multiplier_errors.resting),
        },
        "error": {
            **_error_sets(fit),
            "unfiltered": _errors(fit.unfiltered),
            "with_standstill": _error_sets(fit, standstill=True),
            **({"command": _errors(fit.command_errors)} if fit.command_errors else {}),
        },
        "noise": fit.noise,
        "smoothing": [
            {
                "log": e.name,
                "knots": e.smooth.spacing if e.smooth else None,
                "channels": [
                    {"name": c.column, "noise": c.noise, "residual": c.residual, "how": c.how}
                    for c in e.channels
                ],
            }
            for e in fit.motion.experiments
        ],
        "likelihood": None if fit.likelihood is None else fit.likelihood.described(),
        "filter": {"cutoff": band.cutoff, "motion_bandwidth": band.motion, "unit": "Hz"},
        "condition_number": fit.condition_number,
        "rank": fit.rank,
        **({} if fit.binding is None else {"consistency": fit.binding.json()}),
        **({} if fit.possible is None else {"possible": fit.possible.json(fit.columns.names)}),
        **({} if fit.least_bodies is None else {"least_bodies": fit.least_bodies.json()}),
        **({} if fit.changes is None else {"changes": _changes(fit.changes)}),
        "calibration": _calibration(fit),
        "correlated": [list(pair) for pair in fit.correlation.pairs()],
        "warnings": list(fit.warnings),
    }


def _changes(x: Changes) -> dict[str, Any]:
    entries = [
        {
            "name": change.after.name, "unit": change.after.unit, "changed": change in x.changed,
            "before": change.before.value, "before_stderr": change.before.stderr,
            "value": change.after.value, "stderr": change.after.stderr, "z": change.z,
        }
        for change in x.compared
    ]  # fmt: skip
    return {"since": x.since, "alpha": ALPHA, "least_z": x.least, "compared": entries,
            "not_compared": list(x.apart)}  # fmt: skip


def _entry(value: Value | BaseValue, fit: Fit) -> dict[str, Any]:
    """Return a value's fields, and the share of each cause in the variance of its error."""
    entry = {key: x for key, x in asdict(value).items() if key != "at_bound"}
    if fit.budget is None or not value.stderr:
        return entry
    shares = {name: x for name, x in fit.shares(value.name).items() if x >= LEAST_SHARE}
    return {**entry, "budget": shares}


def _calibration(fit: Fit) -> list[dict[str, Any]]:
    """Return the causes that a fit carries, with priors, and what the data say of each."""
    if fit.budget is None:
        return []
    causes = zip(fit.budget.causes, fit.budget.values, fit.budget.errors, strict=True)
    return [
        {
            "name": cause.name, "kind": cause.kind, "place": cause.place, "prior": cause.scale,
            "unit": cause.unit, "source": cause.source,
            "value": float(value * cause.scale), "stderr": float(error * cause.scale),
        }
        for cause, value, error in causes
    ]  # fmt: skip


def _error_sets(fit: Fit, standstill: bool = False) -> dict[str, Any]:
    return {
        "train": _errors(fit.train, standstill),
        "held_out": _errors(fit.held_out, standstill),
        "validation": {log: _errors(errors, standstill) for log, errors in fit.validation.items()},
    }


def _errors(errors: Mapping[str, Error], standstill: bool = False) -> dict[str, Any]:
    errors_of_joint = {joint: e.with_standstill if standstill else e for joint, e in errors.items()}
    return {
        j: {n: getattr(e, n) for n in ("rms", "relative", "unit")}
        for j, e in errors_of_joint.items()
    }


@dataclass(frozen=True, eq=False)
class Saved:
    """A fit.json read back: a mechanism with its effects and the values of all parameters.

    Attributes:
        name: the file's.
        mechanism: with the effects of the fit.
        point: values of all parameters.
        cutoff: of the filter that the fit was made with [Hz], None for none, "auto" if not stated.
        errors: of the fit by set (`train`, `held out`, a log it was validated on), then joint.
        base_parameters: the combinations that its log determined.
        possible: the same with the nearest possible bodies, where those of the fit cannot exist.
        values: of parameters and effects with their standard errors, by name: `saved["rod.m"]`.
        fitted: names of the bodies' parameters that the fit did not know before.
        motion: always None, as of no fit that is read from a file.
    """

    name: str
    mechanism: Mechanism
    point: Point
    cutoff: float | str | None = "auto"
    errors: Mapping[str, Mapping[str, Error]] = field(default_factory=dict)
    base_parameters: tuple[BaseValue, ...] = ()
    possible: Point | None = None
    values: Mapping[str, Value] = field(default_factory=dict)
    fitted: tuple[str, ...] = ()
    motion: Motion | None = field(default=None, init=False)  # a file does not hold its data

    def __getitem__(self, name: str) -> Value | BaseValue:
        """Return a parameter, effect's parameter or base parameter by its name, as of a `Fit`.

        Raises:
            KeyError: with the nearest name.
        """
        by_name = {value.name: value for value in self.base_parameters} | dict(self.values)
        if name not in by_name:
            raise KeyError(f"no parameter '{name}'; {one_of(name, by_name)}")
        return by_name[name]

    @property
    def dynamic_parameters(self) -> np.ndarray:
        """All bodies' ten parameters (10 · bodies,), in Γ's order."""
        return self.point.pi


_residuals_before: WeakKeyDictionary[Fit, dict[str, Residual]] = WeakKeyDictionary()


def residual_before(fit: Fit, log: str = "") -> Residual:
    """Return the residual of the earlier fit, without one that of the URDF's own numbers, on a
    fit's motion, or on a validation `log` that it has the motion of; each is made once a fit.
    """
    made = _residuals_before.setdefault(fit, {})
    if log not in made:
        motion = fit.motion
        if log and fit.validated_on is not None:
            logs = tuple(e for e in fit.validated_on.experiments if e.name == log)
            motion = replace(fit.validated_on, experiments=logs)
        point = initial(fit.mechanism, fit.motion)
        made[log] = residual_of(fit.earlier or Saved("URDF", fit.mechanism, point), motion)
    return made[log]


def read_fit(path: str | Path, mechanism: Mechanism, *, allow_code: bool = False) -> Saved:
    """Read the model that a fit.json describes, for a mechanism that it was made with.

    Args:
        path: of the fit.json, or of the folder that holds it.
        mechanism: with its links and joints; its effects are those of the fit.
        allow_code: whether effects of one's own that the mechanism lacks may run their Python
            files, which are beside fit.json.

    Raises:
        FitError: if the file is no fit.json or speaks of links, joints or effects that the
            mechanism does not have.
    """
    path = Path(path)
    if path.is_dir():  # given to --out
        path = path / "fit.json"
    try:
        data = json.loads(regular(path).read_text(encoding="utf-8"), parse_constant=_refuse)
    except (OSError, ValueError, RecursionError) as error:
        why = "is no JSON"
        if isinstance(error, FileNotFoundError):
            why = missing_file(path)
        elif isinstance(error, OSError):
            why = f"cannot be read ({error.strerror})"
        raise FitError(f"{path}: {why}; give a fit.json of ident identify") from None
    schema = data.get("schema") if isinstance(data, dict) else type(data).__name__
    if schema != SCHEMA:
        raise FitError(f"{path}: schema is {schema!r}; a fit.json of schema '{SCHEMA}' is expected")
    try:
        return _model(path, data, mechanism, allow_code)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise FitError(
            f"{path}: is no complete fit.json: {error} is missing or wrong; identify again"
        ) from None
    except MechanismError as error:
        raise FitError(f"{path}: is of another mechanism: {error}") from None


def _logged(entry: Mapping[str, Any]) -> Any:
    """Return the value that predicts torques as they are logged, the only one of older files."""
    value = entry.get("as_logged")
    return entry["value"] if value is None else value


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no number")


def _model(path: Path, data: dict[str, Any], mechanism: Mechanism, allow_code: bool) -> Saved:
    lists = data["multipliers"]["names"], mechanism.kinematics.multipliers
    names_in_file, names_here = (
        [n for n in names if not n.startswith("joint.")] for names in lists
    )
    if names_in_file != names_here:  # another mechanism, whose links happen to have the same names
        raise FitError(
            f"{path}: is of another mechanism, {data.get('mechanism')}, whose multipliers are "
            f"{', '.join(names_in_file) or 'none'}; {mechanism.name} has "
            f"{', '.join(names_here) or 'none'}"
        )
    values = {str(entry["name"]): _logged(entry) for entry in data["parameters"]}
    parts = [(e["kind"], e["joint"], e.get("signal", "")) for e in data["effects"]]
    labels = [
        ":".join(filter(None, part)) + (f"@{log_word(log)}" if (log := e.get("log", "")) else "")
        for part, e in zip(parts, data["effects"], strict=True)
    ]
    if any("log" in effect for effect in data["effects"]):
        mechanism = mechanism.for_logs(data["logs"])
    grown = mechanism
    for effect in reversed(mechanism.effects):  # the fit's model did not have it
        grown = grown if effect.label in labels else grown.without(effect.label)
    for label, effect in zip(labels, data["effects"], strict=True):
        kind, joint, signal = effect["kind"], effect["joint"], effect.get("signal", "")
        of_log = {"per": PER_LOG, "log": effect["log"]} if "log" in effect else {}
        effect_here = next((known for known in grown.effects if known.label == label), None)
        if (
            effect_here is not None and effect_here.known
        ):  # the fit's values count, which may be others
            settings = {name: effect_here.setting(name) for name in effect_here.settings}
            finite = {name: x for name, x in settings.items() if np.isfinite(x)}  # else not stated
            freed = grown.placed(replace(effect_here, values=finite))
            effects_here = (freed if known.label == label else known for known in grown.effects)
            grown = replace(grown, effects=tuple(effects_here))
        if effect_here is None and kind in KINDS:
            settings = {k: x for k, x in (effect.get("settings") or {}).items() if x is not None}
            grown = grown + create_effect(kind, joint, settings, signal=signal, **of_log)
        elif effect_here is None:
            new = _own_kind(path, label, effect, allow_code)(tuple(joint.split(",")))
            grown = grown + replace(new, **of_log)
        values |= {str(entry["name"]): _logged(entry) for entry in effect["parameters"]}
    effects = {full for effect in grown.effects for full in effect.names}
    for name in values:
        if name not in effects and name.rpartition(".")[0] not in grown.bodies.links:
            raise FitError(
                f"{path}: parameter '{name}' belongs to no link or effect of {mechanism.name}; "
                f"{one_of(name.split('.')[0], grown.bodies.links)}"
            )
    columns = Columns.of(grown)

    def point_of(values: Mapping[str, float | None]) -> Point:
        given = {name: float(value) for name, value in values.items() if value is not None}
        return Point(grown.bodies.with_values(grown.prior, {**given}), given)

    start, nearest = point_of(values), data.get("possible")
    point = start.at(grown, columns, start.unknowns(columns))
    possible = None if nearest is None else point_of({**values, **nearest["parameters"]})
    cutoff = filtered["cutoff"] if (filtered := data.get("filter")) else "auto"
    errors = data.get("error") or {}
    with_standstill = _sets(errors.get("with_standstill") or {})
    read: dict[str, dict[str, Error]] = {}
    for title, joints in _sets(errors).items():
        for joint, e in (joints or {}).items():
            if e["rms"] is not None:
                every = with_standstill.get(title, {}).get(joint) or {"rms": None, "relative": None}
                sizes = float(e["rms"]), e["relative"], str(e["unit"])
                read.setdefault(title, {})[joint] = Error(*sizes, every["rms"], every["relative"])
    base = tuple(
        BaseValue(
            str(e["name"]), float(e["value"]), float(e["stderr"]), str(e["unit"]),
            *(np.nan if e.get(key) is None else float(e[key])
              for key in ("stderr_noise", "as_logged", "stderr_as_logged")),
        )
        for e in data.get("base_parameters") or () if e["stderr"] is not None
    )  # fmt: skip
    cutoff = cutoff if cutoff in (None, "auto") else float(cutoff)
    every = [*data["parameters"], *(x for effect in data["effects"] for x in effect["parameters"])]
    known = {x["name"]: value for x in every if (value := _read_value(x)) is not None}
    fitted = grown.bodies.select((str(entry["name"]) for entry in data["parameters"]), str(path))
    return Saved(str(path), grown, point, cutoff, read, base, possible, known, fitted)


def _read_value(entry: Mapping[str, Any]) -> Value | None:
    """Return one number of a fit.json; None of one without a value."""
    numbers = {
        key: None if entry.get(key) is None else float(entry[key])
        for key in ("value", "stderr", "prior", "stderr_noise", "as_logged", "stderr_as_logged")
    }
    if numbers["value"] is None:
        return None
    return Value(
        str(entry["name"]),
        numbers["value"],
        numbers["stderr"],
        str(entry.get("unit", "")),
        bool(entry.get("identifiable", numbers["stderr"] is not None)),
        np.nan if numbers["prior"] is None else numbers["prior"],
        bool(entry.get("at_bound", False)),
        numbers["stderr_noise"],
        np.nan if numbers["as_logged"] is None else numbers["as_logged"],
        numbers["stderr_as_logged"],
    )


def unfiltered_errors(folder: Path) -> dict[str, float]:
    """Return by joint the rms [N m | N] of what a fit leaves of torques as they were logged, with
    the noise of the sensors, from a folder that `write_fit` wrote.
    """
    errors = json.loads(regular(folder / "fit.json").read_text(encoding="utf-8"))["error"]
    sizes = errors.get("unfiltered") or errors.get("held_out") or errors["train"]
    return {str(joint): float(size["rms"]) for joint, size in sizes.items() if size["rms"]}


def _sets(errors: Mapping[str, Any]) -> dict[str, Any]:
    """Return errors by set, as `Fit.errors` names them, then joint."""
    sets = {"train": errors.get("train"), "held out": errors.get("held_out")}
    return {**sets, **(errors.get("validation") or {})}


def _own_kind(path: Path, label: str, entry: dict[str, Any], allow_code: bool) -> type[Effect]:
    """Return the kind of an effect that is none of the library, from the file beside fit.json."""
    name = entry.get("file")
    if name is None or Path(str(name)).name != name:
        raise FitError(
            f"{path}: effect '{label}' is none of the library: {one_of(entry['kind'], KINDS)}; if "
            "it is one of your own, give a mechanism whose mechanism.toml has it"
        )
    try:
        return read_user_effect(path.parent / name, entry["kind"], allow_code=allow_code)
    except MechanismError as error:
        raise FitError(f"{path}: effect '{label}' is none of the library: {error}") from None


def identified_urdf(fit: Fit, *, possible: bool = True) -> bytes:
    """Return the URDF's text with new `<inertial>` numbers for the links of identified bodies.

    With `possible`, bodies that cannot exist are replaced by the nearest that can, and those that
    move without mass or inertia get the least that a simulator takes (`fit/least_bodies.py`), which
    a comment in the file states; impossible links that stand still have no inertia there. Without,
    the torques are exactly those of the fit.

    All else is as the user wrote it; FitError if a body has first moments and no mass.
    A body is its own link and those fixed to it; these keep their inertias, and the body's own link
    carries the rest. Pinocchio gives the same torques for it as the fit does.
    """
    mechanism = fit.mechanism
    nearest, least = (fit.possible, fit.least_bodies) if possible else (None, None)
    if nearest is None:
        pi = _with_masses(fit)
    else:
        pi = fit.columns.dynamic_parameters(mechanism, nearest.x)
    links = bodies_with_unknowns(mechanism)
    if least is not None:
        pi = pi + least.pi
        links = list(dict.fromkeys([*links, *least.links]))
    inertials = link_inertials(mechanism, pi, links)
    if possible:
        inertials |= dict.fromkeys(_impossible_at_rest(mechanism.model))
    text, where = source_of(mechanism).urdf, str(mechanism.urdf)
    comment = "" if least is None else least.words
    return with_inertials(text, where, inertials, comment)


def _impossible_at_rest(model: pin.Model) -> list[str]:
    """Return links that stand still whose inertia no body can have: no torque feels it, and a
    simulator refuses the file for it.
    """
    fixed = (f for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint == 0)
    bodies = [(f.name, f.inertia.toDynamicParameters()) for f in fixed]
    return [
        name for name, pi in bodies if pi.any() and np.linalg.eigvalsh(pseudo_inertia(pi))[0] <= 0
    ]


def link_inertials(
    mechanism: Mechanism, pi: np.ndarray, links: Iterable[str]
) -> dict[str, np.ndarray | None]:
    """Return by link of a URDF the ten parameters (10,) that its own `<inertial>` says, None for
    one that is left out, so that some bodies have parameters `pi` (10 · bodies,).
    """
    inertials: dict[str, np.ndarray | None] = {}
    for link in links:
        body = pi[mechanism.bodies.columns(link)]
        joint = mechanism.bodies.links.index(link) + 1
        own_body = body - (fixed := fixed_parameters(mechanism.model, joint))
        rest, whole_body = (
            np.linalg.eigvalsh(pseudo_inertia(item))[0] for item in (own_body, body)
        )
        # without its fixed links it must have mass, and be possible if the body is
        if fixed.any() and not (own_body[0] > 0 and (rest > 0 or whole_body <= 0)):
            own_body = body  # nothing is left for the link itself: it takes the whole body
            frames = (f for f in mechanism.model.frames if f.type == pin.FrameType.BODY)
            inertials |= dict.fromkeys(f.name for f in frames if f.parentJoint == joint)
        inertials[link] = own_body
    return inertials


def _with_masses(fit: Fit) -> np.ndarray:
    """Return dynamic parameters in which no body with first moments is massless: a mass that the
    data do not determine may be shifted along the directions that no torque feels.
    """
    x, base, columns = fit.estimate.x.copy(), fit.estimate.base, fit.columns
    # possible bodies have masses, however small
    for link in () if fit.binding else fit.mechanism.bodies.links:
        body = columns.dynamic_parameters(fit.mechanism, x)[fit.mechanism.bodies.columns(link)]
        if abs(body[0]) > LEAST_MASS or not body[1:].any():
            continue
        at = columns.index.get(f"{link}.m", -1)
        if at not in base.dependent:
            raise FitError(
                f"link '{link}' was found to have first moments but no mass, which a URDF cannot "
                f"say; make '{link}.m' unknown or give the link a mass"
            )
        column = base.K[:, int(np.flatnonzero(base.dependent == at)[0])]
        x[at] += 1.0
        x[base.independent] -= column
    return columns.dynamic_parameters(fit.mechanism, x)
