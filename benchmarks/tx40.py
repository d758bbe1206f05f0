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
    """‖τ − τ̂‖/‖τ‖ of every joint, of the rows that were fitted and of all samples as logged."""
    joints = list(next(iter(fits.values())).train)
    for title, found in (
        (f"relative error below {cutoff:.3g} Hz [%]", filtered),
        ("relative error unfiltered, all samples [%]", unfiltered),
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
    """Beside the published values, without and with the coupling of joints 5 and 6."""
    alone, coupled = (fits[MODELS[i][0]] for i in (1, 3))
    rows = [["friction", "without coupling", "with everything", "published"]]
    for kind, word in (("viscous", "Fv"), ("coulomb", "Fc")):
        for number, published in enumerate(PUBLISHED[kind], start=1):
            name = f"{kind}.joint_{number}.{word}"
            rows.append([name, said(alone[name]), said(coupled[name]), f"{published}"])
    for word, interval in PUBLISHED_COUPLING.items():
        name = f"{COUPLING.replace(':', '.')}.{word}"
        rows.append([name, "", said(coupled[name]), interval])
    show(rows)


def base_parameters(fit: ident.Fit, table: Path) -> None:
    """All that the published table and the fit have in common, largest disagreement said."""
    found = {v.name.split()[0]: v for v in fit.base_parameters}
    coupling = fit[f"{COUPLING.replace(':', '.')}.Fvm"]
    rows = [["base parameter", "here", "±", "published", "±", "apart", "in both ±"]]
    agree = total = 0
    with table.open() as file:
        for expression, _, _, wls, percent in csv.reader(file):
            lead = expression.split()[0]
            if ours(lead) not in found:
                rows.append([lead, "–", "", wls, "", "", ""])
                continue
            mine, published = found[ours(lead)], float(wls)
            value, name = mine.value, lead
            if lead in ("fv5", "fv6"):  # theirs holds all of a joint's, also the coupling's
                value, name = value + coupling.value, f"{lead} (+ Fvm)"
            theirs = abs(published) * float(percent) / 100
            apart = abs(value - published)
            spreads = apart / float(np.hypot(mine.stderr, theirs))
            total, agree = total + 1, agree + (spreads < 3)
            rows.append(
                [
                    name,
                    f"{value:.4g}",
                    f"{mine.stderr:.2g}",
                    f"{published:.4g}",
                    f"{theirs:.2g}",
                    f"{apart:.2g}",
                    f"{spreads:.1f}",
                ]
            )
    show(rows)
    print(f"{agree} of {total} within three joint standard errors")


def ours(lead: str) -> str:
    """`Izz1` of the published table is `link_1.Lzz` here."""
    if lead in OF_COUPLING:
        return f"{COUPLING.replace(':', '.')}.{OF_COUPLING[lead]}"
    kind, joint = lead[:-1], lead[-1]
    if kind in EFFECTS:
        effect, unknown = EFFECTS[kind]
        return f"{effect}.joint_{joint}.{unknown}"
    return f"link_{joint}.{kind.replace('I', 'L')}"


def said(found: object) -> str:
    value, stderr = found.value, found.stderr  # type: ignore[attr-defined]
    return f"{value:.3g}" if stderr is None else f"{value:.3g} ± {stderr:.2g}"


def show(rows: list[list[str]]) -> None:
    width = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    print()
    for row in rows:
        cells = [c.ljust(w) if i == 0 else c.rjust(w) for i, (c, w) in enumerate(zip(row, width))]
        print("  ".join(cells).rstrip())


if __name__ == "__main__":
    main()
