"""fit.json: written from a fit, and read back as a model of the same mechanism."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.effects import KINDS, Effect
from ident.effects import create as create_effect
from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.errors import FitError, MechanismError, not_there, one_of
from ident.fit.values import Value
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import COUNT, about_origin, split
from ident.motion import Experiment, Motion
from ident.residual.error import Error

if TYPE_CHECKING:
    from ident.fit.fit import Fit

SCHEMA = "ident.fit/1"


def _number(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


def _value(value: Value) -> dict[str, Any]:
    return {
        "name": value.name,
        "value": _number(value.value),
        "stderr": _number(value.stderr),
        "unit": value.unit,
        "identifiable": value.identifiable,
        "prior": _number(value.prior),
    }


def _errors(errors: Mapping[str, Error]) -> dict[str, Any]:
    return {
        name: {"rms": _number(e.rms), "relative": _number(e.relative), "unit": e.unit}
        for name, e in errors.items()
    }


def _smoothing(e: Experiment) -> dict[str, Any]:
    """What was done to an experiment's channels, noise and residual in their units."""
    return {
        "log": e.name,
        "knots": e.smooth.spacing if e.smooth else None,
        "channels": [
            {"name": c.column, "noise": c.noise, "residual": c.residual, "how": c.how}
            for c in e.channels
        ],
    }


def fit_json(fit: Fit) -> dict[str, Any]:
    """The content of fit.json."""
    kinematics, multipliers = fit.mechanism.kinematics, fit.mechanism.multipliers
    band = fit.motion.band
    return {
        "schema": SCHEMA,
        "mechanism": fit.mechanism.name,
        "logs": list(fit.motion.names),
        "samples": fit.motion.samples,
        "rows": fit.rows,
        "parameters": [_value(value) for value in fit.parameters],
        "base_parameters": [
            {"name": v.name, "value": v.value, "stderr": _number(v.stderr), "unit": v.unit}
            for v in fit.base_parameters
        ],
        "effects": [
            {
                "kind": each.effect.kind,
                "joint": ",".join(each.effect.joints),
                "settings": {name: each.effect.setting(name) for name in each.effect.settings},
                "parameters": [_value(value) for value in each.parameters],
            }
            for each in fit.effects
        ],
        "multipliers": {
            "names": list(kinematics.multipliers),
            "unit": list(kinematics.units),
            "basis": multipliers.basis,
            "spacing": multipliers.spacing,
            "file": "multipliers.csv",
        },
        "error": {
            "train": _errors(fit.train),
            "held_out": _errors(fit.held_out),
            "unfiltered": _errors(fit.unfiltered),
            "validation": {log: _errors(errors) for log, errors in fit.validation.items()},
        },
        "smoothing": [_smoothing(e) for e in fit.motion.experiments],
        "likelihood": None if fit.likelihood is None else fit.likelihood.described(),
        "filter": {"cutoff": band.cutoff, "motion_bandwidth": band.motion, "unit": "Hz"},
        "condition_number": _number(fit.condition_number),
        "rank": fit.rank,
        **({} if fit.binding is None else {"consistency": fit.binding.json()}),
        **({} if fit.essential is None else {"essential": fit.essential.json()}),
        "correlated": [list(pair) for pair in fit.correlation.pairs()],
        "warnings": list(fit.warnings),
    }


@dataclass(frozen=True, eq=False)
class Saved:
    """A fit.json read back: a mechanism with its effects and the values of all unknowns.

    Attributes:
        name: the file's.
        mechanism: with the effects of the fit.
        columns, x: unknowns and their values (k,).
        point: values of all parameters.
        cutoff: of the filter that the fit was made with [Hz], None for none, "auto" if not said.
        errors: of the fit by set (`train`, `held out`, a log it was validated on), then joint.
    """

    name: str
    mechanism: Mechanism
    columns: Columns
    x: np.ndarray
    point: Point
    cutoff: float | str | None = "auto"
    errors: Mapping[str, Mapping[str, Error]] = field(default_factory=dict)

    @property
    def dynamic_parameters(self) -> np.ndarray:
        """All bodies' ten parameters (10 · bodies,), in Γ's order."""
        return self.point.pi

    @property
    def motion(self) -> Motion | None:
        """None: a file does not hold what it was fitted to."""
        return None


def read_fit(path: str | Path, mechanism: Mechanism) -> Saved:
    """The model that a fit.json describes, for a mechanism that it was made with.

    Args:
        path: of the fit.json, or of the folder that holds it.
        mechanism: with its links and joints; effects may differ.

    Raises:
        FitError: if the file is no fit.json or speaks of links, joints or effects that the
            mechanism does not have.
    """
    path = Path(path)
    if path.is_dir():  # what --out was given
        path = path / "fit.json"
    try:
        data = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse)
    except FileNotFoundError:
        raise FitError(f"{path}: {not_there(path)}; give a fit.json of ident identify") from None
    except OSError as error:
        raise FitError(
            f"{path}: cannot be read ({error.strerror}); give a fit.json of ident identify"
        ) from None
    except (ValueError, RecursionError) as error:
        raise FitError(f"{path}: is no JSON: {error}; give a fit.json of ident identify") from None
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        found = data.get("schema") if isinstance(data, dict) else type(data).__name__
        raise FitError(f"{path}: schema is {found!r}; a fit.json of schema '{SCHEMA}' is expected")
    try:
        return _model(path, data, mechanism)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise FitError(
            f"{path}: is no complete fit.json: {error} is missing or wrong; identify again"
        ) from None
    except MechanismError as error:
        raise FitError(f"{path}: is of another mechanism: {error}") from None


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no number")


def _check_closures(path: Path, data: dict[str, Any], mechanism: Mechanism) -> None:
    """Refuse the fit of another mechanism whose links happen to have the same names."""
    lists = data["multipliers"]["names"], mechanism.kinematics.multipliers
    theirs, ours = ([n for n in names if not n.startswith("joint.")] for names in lists)
    if theirs != ours:
        raise FitError(
            f"{path}: is of another mechanism, {data.get('mechanism')}, whose multipliers are "
            f"{', '.join(theirs) or 'none'}; {mechanism.name} has {', '.join(ours) or 'none'}"
        )


def _model(path: Path, data: dict[str, Any], mechanism: Mechanism) -> Saved:
    _check_closures(path, data, mechanism)
    values = {str(entry["name"]): entry["value"] for entry in data["parameters"]}
    grown = mechanism
    for effect in data["effects"]:
        kind, label = effect["kind"], ":".join(filter(None, (effect["kind"], effect["joint"])))
        own = next((known for known in grown.effects if known.label == label), None)
        if own is not None and own.known:
            grown = _freed(grown, own, effect["parameters"])
        if own is None:
            if kind not in KINDS:
                raise FitError(
                    f"{path}: effect '{label}' is none of the library: {one_of(kind, KINDS)}; if "
                    "it is one of your own, give a mechanism whose mechanism.toml has it"
                )
            grown = grown + create_effect(kind, effect["joint"], effect.get("settings"))
        values |= {str(entry["name"]): entry["value"] for entry in effect["parameters"]}
    columns = Columns.of(grown)
    x = columns.prior.copy()
    for name, i in columns.index.items():
        if values.get(name) is not None:
            x[i] = float(values[name])
    pi = columns.dynamic_parameters(grown, x)
    named = set(columns.names)
    for name, value in values.items():
        link, _, word = name.rpartition(".")
        if name in named or value is None or link not in grown.bodies.links:
            continue
        if word[:1] != "I" or f"{link}.L{word[1:]}" not in columns.index:
            continue
        body = pi[grown.bodies.columns(link)]
        shift = about_origin(*split(body)[:2])
        x[columns.index[f"{link}.L{word[1:]}"]] = (
            value + shift["xyz".index(word[1]), "xyz".index(word[2])]
        )
    strange = [name for name in values if not _belongs(name, grown)]
    if strange:
        raise FitError(
            f"{path}: parameter '{strange[0]}' belongs to no link or effect of {mechanism.name}; "
            f"{one_of(strange[0].split('.')[0], grown.bodies.links)}"
        )
    assert len(pi) == COUNT * len(grown.bodies.links)
    told = {name: float(value) for name, value in values.items() if value is not None}
    point = Point.prior(grown).with_values({n: v for n, v in told.items() if _belongs(n, grown)})
    return Saved(
        str(path), grown, columns, x, point.at(grown, columns, x), _cutoff(data), _read_errors(data)
    )


def _freed(mechanism: Mechanism, own: Effect, told: list[dict[str, Any]]) -> Mechanism:
    """The mechanism without known values of an effect that the fit found to be others."""
    names = dict(zip(own.names, (each.name for each in own.parameters), strict=True))
    other = {
        names[each["name"]]
        for each in told
        if each["name"] in names and each["value"] != own.values[names[each["name"]]]
    }
    kept = {name: value for name, value in own.values.items() if name not in other}
    return mechanism + replace(own, values=kept) if other else mechanism


def _cutoff(data: dict[str, Any]) -> float | str | None:
    told = data.get("filter")
    if not isinstance(told, dict) or "cutoff" not in told:
        return "auto"
    return None if told["cutoff"] is None else float(told["cutoff"])


def _read_errors(data: dict[str, Any]) -> dict[str, dict[str, Error]]:
    told = data.get("error")
    if not isinstance(told, dict):
        return {}
    sets = {"train": told.get("train"), "held out": told.get("held_out")}
    return {
        title: {
            joint: Error(float(e["rms"]), e["relative"], str(e["unit"]))
            for joint, e in errors.items()
            if e["rms"] is not None
        }
        for title, errors in {**sets, **(told.get("validation") or {})}.items()
        if errors
    }


def _belongs(name: str, mechanism: Mechanism) -> bool:
    effects = {full for effect in mechanism.effects for full in effect.names}
    return name in effects or name.rpartition(".")[0] in mechanism.bodies.links
