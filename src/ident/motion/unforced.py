"""A base that moves though nothing in the log moves it.

    Γ_i p = 0     of slides i at the root that have no motor, no wrench, no closure and no effect

is solved by masses of 0. It is a fact (momentum is conserved) only where the bodies' forces cancel:

    |Σ_b Γ_ib π_b| against Σ_b |Γ_ib π_b|,     π of the file, rms over the motion
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import COUNT, regressor
from ident.motion.state import State

UNBALANCED = 0.5  # range: share of the bodies' forces that is left of their sum; a body alone has 1
LOOKED_AT = 200  # work: samples of a log


def unforced_base(mechanism: Mechanism, experiments: Sequence[State]) -> str:
    """Return what is missing where a base moves without any force; "" where nothing is."""
    slides = free_slides(mechanism)
    both = zip(mechanism.bodies.names, mechanism.prior, strict=True)
    known = {name for name, x in both if name.endswith(".m") and x} - {*mechanism.unknown}
    if not slides or mechanism.closures or known:
        return ""
    acting = [effect for effect in mechanism.effects if {*effect.acting} & {*slides}]
    if acting:
        return "" if any(x.known for x in acting) else _without_scale(mechanism, experiments)
    for e in experiments:
        if e.wrench is not None and np.any(e.wrench):
            continue
        samples = np.flatnonzero(e.usable)[:: max(1, int(e.usable.sum()) // LOOKED_AT)]
        gamma = regressor(mechanism.model, e.q[samples], e.v[samples], e.a[samples])
        rows = gamma[:, [mechanism.joint(name).index for name in slides]]
        bodies = (rows * mechanism.prior).reshape(*rows.shape[:2], -1, COUNT).sum(axis=3)
        net = np.sqrt(np.mean(bodies.sum(axis=2) ** 2))
        total = np.sqrt(np.mean(np.abs(bodies).sum(axis=2) ** 2))
        if net > UNBALANCED * total:
            links = mechanism.bodies.links
            heavy = [x for x in links if mechanism.prior[mechanism.bodies.columns(x)].any()]
            return (
                f"{e.name}: {mechanism.name} moves along {', '.join(slides)} and the log has no "
                "force that moves or holds it, so every mass would come out as 0; log the forces "
                f"on it as wrench.{(heavy or links)[0]}.fx … mz (thrust of rotors, forces of feet, "
                'each at its own link), or what holds it is a [[closure]] to link = "world"'
            )
    return ""


def _without_scale(mechanism: Mechanism, experiments: Sequence[State]) -> str:
    """Return what is missing where all forces have unknown factors and no mass is known, so that
    every equation is homogeneous: Γ p + E c = 0.
    """
    if any(np.any(e.tau) or (e.wrench is not None and np.any(e.wrench)) for e in experiments):
        return ""
    both = zip(mechanism.bodies.names, mechanism.prior, strict=True)
    masses = [name for name, x in both if name.endswith(".m") and x]
    factors = [
        x.full[parameter.name]
        for x in mechanism.effects if x.acting
        for parameter in x.parameters if parameter in x.unknowns or parameter.name == x.scale
    ]  # fmt: skip
    return (
        f"{experiments[0].name}: no force and no mass has a known size, so only the ratios of "
        f"masses and of {', '.join(factors)} can be identified; state one value, as [parameters] "
        f'known = ["{(masses or ["body.m"])[0]}"] in mechanism.toml or a factor in its [[effect]], '
        "and all others are in proportion to it"
    )


def free_slides(mechanism: Mechanism) -> list[str]:
    """Return passive slides with only passive joints between them and the ground."""
    model, slides = mechanism.model, []
    for index in range(1, model.njoints):
        above = [model.names[i] for i in model.supports[index] if i > 0]
        passive = all(name in mechanism.passive for name in above)
        if passive and not mechanism.joint(model.names[index]).rotational:
            slides.append(model.names[index])
    return slides
