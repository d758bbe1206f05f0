"""The Stäubli TX40's log: errors as effects are added, friction and base parameters as published.

    python benchmarks/tx40.py

The log is not in this repository: it is looked for in $IDENT_DATA, or ../shared/data beside the
checkout (staubli_tx40/tx40.csv, tx40.urdf, TX40_bp_5.csv).
"""

import csv
import os
import sys
from pathlib import Path

import numpy as np

import ident

ROOT = Path(__file__).resolve().parents[1]
COUPLING = "coupling:joint_5,joint_6"
STEM = COUPLING.replace(":", ".")
MODELS = (  # each with all that stands before it
    ("rigid bodies", ()),
    ("+ viscous + coulomb", ("viscous", "coulomb")),
    (f"+ {COUPLING}", (COUPLING,)),
    ("+ rotor_inertia + torque_offset", ("rotor_inertia", "torque_offset")),
)
PUBLISHED = {  # data/README.md
    "viscous": (8.03, 5.52, 2.00, 1.11, 1.85, 0.64),  # [N m s/rad]
    "coulomb": (7.23, 8.25, 6.29, 2.51, 3.0, 0.25),  # [N m]
}
PUBLISHED_COUPLING = {"Im": "0.0077-0.0096", "Fvm": "0.60-0.62", "Fcm": "1.95-2.03"}
EFFECTS = {  # names of the published table: effect, its unknown
    "fv": ("viscous", "Fv"),
    "fs": ("coulomb", "Fc"),
    "Ia": ("rotor_inertia", "Ia"),
    "off": ("torque_offset", "c"),
}
OF_COUPLING = {"Iam6": "Im", "fvm6": "Fvm", "fsm6": "Fcm"}


def main() -> None:
    place = Path(os.environ.get("IDENT_DATA", ROOT.parent / "shared" / "data")) / "staubli_tx40"
    if not (place / "tx40.csv").is_file():
        print(f"no measurements at {place}; set IDENT_DATA to the folder that holds staubli_tx40")
        sys.exit(0)
    mechanism = ident.load(place / "tx40.urdf")
    motion = ident.complete(mechanism, place / "tx40.csv")
    fits = {}
    for title, effects in MODELS:
        for effect in effects:
            mechanism = mechanism.with_effect(effect)
        fits[title] = ident.identify(mechanism, motion)
    cutoff = motion.band.cutoff
    assert cutoff is not None
    print(f"{motion.samples} samples, filter at {cutoff:.3g} Hz")
    errors(fits, cutoff)
    friction(fits)
    base_parameters(fits[MODELS[-1][0]], place / "TX40_bp_5.csv")


def errors(fits: dict[str, ident.Fit], cutoff: float) -> None:
    """‖τ − τ̂‖/‖τ‖ of every joint: filtered as fitted, and of the samples as logged."""
    joints = list(next(iter(fits.values())).train)
    for title, found in (
        (f"relative error below {cutoff:.3g} Hz [%]", filtered),
        ("relative error unfiltered [%]", unfiltered),
    ):
        rows = [[title, *(joint.removeprefix("joint_") for joint in joints)]]
        rows += [[name, *(f"{100 * x:.1f}" for x in found(fit))] for name, fit in fits.items()]
        show(rows)


def filtered(fit: ident.Fit) -> list[float]:
    return [error.relative or np.nan for error in fit.train.values()]


def unfiltered(fit: ident.Fit) -> list[float]:
    (p,) = fit.predict()
    size = np.linalg.norm(p.measured[p.usable], axis=0)
    return list(np.linalg.norm(p.residual[p.usable], axis=0) / size)


def friction(fits: dict[str, ident.Fit]) -> None:
    """Beside the published values; viscous ones of joints 5 and 6 hold the coupling's there."""
    titles = [title for title, _ in MODELS[1:]]
    rows = [["friction", *titles, "published"]]
    for kind, word in (("viscous", "Fv"), ("coulomb", "Fc")):
        for number, published in enumerate(PUBLISHED[kind], start=1):
            names = [f"{kind}.joint_{number}.{word}"]
            shared = [f"{STEM}.Fvm"] if kind == "viscous" and number in (5, 6) else []
            found = [total(fits[titles[0]], *names)]
            found += [total(fits[title], *names, *shared) for title in titles[1:]]
            rows.append([" + ".join([*names, *(["Fvm"] * len(shared))]), *map(said, found)])
            rows[-1].append(f"{published:g}")
    for word, interval in PUBLISHED_COUPLING.items():
        found = [total(fits[title], f"{STEM}.{word}") for title in titles[1:]]
        rows.append([f"{STEM}.{word}", "", *map(said, found), interval])
    show(rows)


def total(fit: ident.Fit, *names: str) -> tuple[float, float]:
    """The sum of some base parameters and its standard error; each by its leading unknown."""
    leads = [v.name.split()[0] for v in fit.base_parameters]
    at = [leads.index(name) for name in names]
    value = sum(fit.base_parameters[i].value for i in at)
    return value, float(np.sqrt(fit.covariance[np.ix_(at, at)].sum()))


def base_parameters(fit: ident.Fit, table: Path) -> None:
    """Beside the published ones (weighted least squares), in multiples of both standard errors."""
    rows = [["base parameter", "here", "±", "published", "±", "apart by", "/ both ±"]]
    ratios = []
    with table.open() as file:
        for expression, _, _, wls, percent in csv.reader(file):
            lead = expression.split()[0]
            shared = [f"{STEM}.Fvm"] if lead in ("fv5", "fv6") else []
            value, stderr = total(fit, ours(lead), *shared)
            published = float(wls)
            theirs = abs(published) * float(percent) / 100
            apart = abs(value - published)
            ratios.append(apart / float(np.hypot(stderr, theirs)))
            numbers = (f"{value:.4g}", f"{stderr:.2g}", f"{published:.4g}", f"{theirs:.2g}")
            name = f"{lead} (+ Fvm here)" if shared else lead
            rows.append([name, *numbers, f"{apart:.2g}", f"{ratios[-1]:.1f}"])
    show(rows)
    near = sum(ratio < 1 for ratio in ratios)
    print(f"{near} of {len(ratios)} within one joint standard error, largest {max(ratios):.1f}")


def ours(lead: str) -> str:
    """`Izz1` of the published table is `link_1.Lzz` here."""
    if lead in OF_COUPLING:
        return f"{STEM}.{OF_COUPLING[lead]}"
    kind, joint = lead[:-1], lead[-1]
    if kind in EFFECTS:
        effect, unknown = EFFECTS[kind]
        return f"{effect}.joint_{joint}.{unknown}"
    return f"link_{joint}.{kind.replace('I', 'L')}"


def said(found: tuple[float, float]) -> str:
    return f"{found[0]:.3g} ± {found[1]:.2g}"


def show(rows: list[list[str]]) -> None:
    width = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    print()
    for row in rows:
        others = [cell.rjust(w) for cell, w in zip(row[1:], width[1:], strict=True)]
        print("  ".join([row[0].ljust(width[0]), *others]).rstrip())


if __name__ == "__main__":
    main()
