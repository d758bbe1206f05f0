"""What the present model predicts, for effects whose columns depend on it.

    load  f_j = Γ_j π − f_e        torque  τ̂_j = f_j + Σ E_j c of effects that do not ask for it
    λ = −(K⁺ᵀ f)_λ                 in a closure's own joint both are |λ|, the size of its force

None of it sees the measured torque of the joint.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ident.equations.samples import Samples

CHUNK = 4096


def predicted(s: Samples, joints: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """(torque, load), both (n, joints) [N m | N]; zero at passive joints."""
    return _of_part(s, joints, *forces(s))


def forces(s: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Generalised forces (n, nv): rigid bodies less wrenches; effects that ask for nothing."""
    key = ("forces",)
    if key not in s.memo:
        n, nv = len(s.e), s.mechanism.model.nv
        found = np.empty((2, n, nv))
        for start in range(0, n, CHUNK):
            part = slice(start, min(start + CHUNK, n))
            found[:, part] = _forces(s.generalised(part))
        s.memo[key] = found
    rigid, others = s.memo[key]
    return rigid[s.part], others[s.part]


def predicted_multipliers(s: Samples) -> np.ndarray:
    """λ (n, m) [N | N m]."""
    rigid, others = forces(s)
    return _multipliers(s.generalised(s.part), rigid + others)


def _forces(s: Samples) -> list[np.ndarray]:
    """Generalised forces (n, nv): rigid bodies less wrenches; effects that ask for nothing."""
    assert s.point is not None
    rigid = s.gamma @ s.point.pi
    if s.wrench is not None:
        rigid = rigid - s.wrench
    others = np.zeros(s.shape)
    for effect in s.mechanism.effects:
        c, shape = s.point.of(effect)
        if not effect.implicit and effect.unknowns and len(shape) == len(effect.shapes):
            s.add_effect(others, effect, c, shape)
    return [rigid, others]


def _multipliers(s: Samples, f: np.ndarray) -> np.ndarray:
    e = s.e
    assert e.pinv is not None
    others = tuple(name for name in s.mechanism.driven if name not in e.independent)
    m = len(s.mechanism.kinematics.multipliers)
    return -np.einsum("nij,ni->nj", e.pinv[s.part][:, :, :m], f - s.measured(others))


def _of_part(
    bare: Samples, joints: tuple[str, ...], rigid: np.ndarray, others: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    s = bare.generalised(bare.part)
    torque, load = np.zeros((len(s), len(joints))), np.zeros((len(s), len(joints)))
    e, mechanism = s.e, s.mechanism
    surplus = tuple(name for name in mechanism.driven if name not in e.independent)
    for i, name in enumerate(joints):
        joint = mechanism.joint(name)
        if e.pinv is None:
            load[:, i] = rigid[:, joint.index]
            torque[:, i] = load[:, i] + others[:, joint.index]
        elif name in e.independent:
            u = e.independent.index(name) - len(e.independent)
            extract = e.pinv[s.part][:, :, u]
            known = s.measured(surplus) if surplus else 0.0
            load[:, i] = np.einsum("ni,ni->n", extract, rigid - known)
            torque[:, i] = load[:, i] + np.einsum("ni,ni->n", extract, others)
        elif name in mechanism.driven:
            torque[:, i] = load[:, i] = e.tau[s.part][:, mechanism.driven.index(name)]
        elif not joint.in_tree:
            owners = _closures_of(name)
            names = zip(mechanism.kinematics.multipliers, mechanism.kinematics.units, strict=True)
            mine = [
                k
                for k, (n, unit) in enumerate(names)
                if n.rpartition(".")[0] in owners and unit == "N"
            ]
            force = _multipliers(s, rigid + others)[:, mine]
            torque[:, i] = load[:, i] = np.linalg.norm(force, axis=1)
    return torque, load


def _closures_of(joint: str) -> set[str]:
    """Names that the closure of an own joint can have: `closure.<name>[.z|.rz]`, `joint.<name>`."""
    bare = joint.removeprefix("closure.")
    return {bare, bare.removesuffix(".z").removesuffix(".rz"), f"joint.{joint}"}
