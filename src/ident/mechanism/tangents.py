"""Derivatives of Γ(q, v, a) π by the motion, of all joints in a few passes over many samples.

In the frame of the world, about its origin: S the axes of the joints, V and A velocities and
accelerations less gravity, I inertias, F forces, of which those of a joint's subtree are summed.
Seen from the bodies that joint j carries, a step of it changes their V by δ and A by α + δ × V, and
so their forces by I α + [D w; 2 w × P], w the angular part of δ, P the momentum:

    q   δ = V_p × S, α = A_p × S − δ × V_p       p: the joint's parent
    v   δ = S, α = 2 V_p × S
    a   δ = 0, α = S
    D w = tr(L) w × V_w + 2 V_w × (L w) + 2 h × (w × V_l)       L, h: moments about the origin

Joints before j feel S × F as well, by q. Equal to differences of Γ π (`tests/truth/
test_regressor.py`). Source: J. Carpentier, N. Mansard, Robotics: Science and Systems, 2018.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ident.mechanism.batched import COUNT, MOMENTS, PIECE, Array, Joint, cross, dot, rotated

Twist = tuple[Array, Array]  # of angular and linear parts (3, n)


def tangents(
    model: pin.Model, joints: list[Joint], q: Array, v: Array, a: Array, pi: Array
) -> Array:
    """Return ∂(Γ π)_k/∂(q, v, a)_j, (3, nv k, nv j, n), of π (10 · bodies,), possible or not."""
    out = np.zeros((3, model.nv, model.nv, len(q)))
    for start in range(0, len(q), PIECE):
        part = slice(start, min(start + PIECE, len(q)))
        q_part, v_part, a_part = (np.ascontiguousarray(x[part].T) for x in (q, v, a))
        _fill_tangents(out[..., part], model, joints, q_part, v_part, a_part, pi)
    return out


def _fill_tangents(
    out: Array, model: pin.Model, joints: list[Joint], q: Array, v: Array, a: Array, pi: Array
) -> None:
    """Fill ∂(Γ π)/∂(q, v, a) (3, nv, nv, n) of q (nq, n), v, a (nv, n)."""
    none = np.zeros((3, q.shape[1]))
    rest = (none, none), (none, none - np.array(model.gravity.linear)[:, None])
    frames: list[tuple[Array, Array]] = []
    moves: list[tuple[Twist, Twist]] = []  # V and A of each body
    steps: list[tuple[Twist, tuple[Twist, ...]]] = []  # S, and the α of q, v, a of each joint
    turns: list[tuple[Array, Array]] = []  # w of q and v
    sums: list[list[Array]] = []  # m, h, L, P, D and F of each subtree
    paths: list[list[int]] = []  # joints from the base to each
    for i, (joint, body) in enumerate(zip(joints, pi.reshape(-1, COUNT), strict=True)):
        R, p = joint.placement(q)
        V, A = moves[joint.parent] if joint.parent >= 0 else rest
        if joint.parent >= 0:
            R_p, p_p = frames[joint.parent]
            R, p = rotated(R_p, R, back=False), p_p + rotated(R_p, p + none, back=False)
        frames.append((R, p + none))
        axis = np.tensordot(joint.axis, R, axes=(0, 1))
        S = (axis, cross(frames[i][1], axis)) if joint.turns else (none, axis)
        turned = twisted(V, S)
        of_q = twisted(A, S), twisted(turned, V)
        alphas = (of_q[0][0] - of_q[1][0], of_q[0][1] - of_q[1][1]), (2 * turned[0], 2 * turned[1])
        steps.append((S, (*alphas, S)))
        turns.append((turned[0], S[0]))
        V = V[0] + S[0] * v[joint.v], V[1] + S[1] * v[joint.v]
        A = tuple(x + s * a[joint.v] + t * v[joint.v] for x, s, t in zip(A, S, turned, strict=True))
        moves.append((V, A))
        sums.append(_at_origin(*frames[i], body, V, A))
        paths.append([*(paths[joint.parent] if joint.parent >= 0 else []), i])
    for i in reversed(range(len(joints))):
        if (below := joints[i].parent) >= 0:
            sums[below] = [x + y for x, y in zip(sums[below], sums[i], strict=True)]
    for k, (joint, path) in enumerate(zip(joints, paths, strict=True)):
        (S, every), (m, h, L, P, D, force, moment) = steps[k], sums[k]
        momentum = rotated(L, S[0], back=True) + cross(h, S[1]), m * S[1] - cross(h, S[0])
        by_turn = rotated(D, S[0], back=True) + 2 * cross(P, S[1])
        for j in path:  # what moves joint k's subtree, in its row
            for order, alpha in enumerate(steps[j][1]):
                row = out[order, joint.v, joints[j].v]
                row += dot(alpha[0], momentum[0]) + dot(alpha[1], momentum[1])
                if order < 2:
                    row += dot(turns[j][order], by_turn)
        for order, alpha in enumerate(every):  # what joint k does in the rows before it
            f = m * alpha[1] - cross(h, alpha[0])
            moments = rotated(L, alpha[0], back=True) + cross(h, alpha[1])
            if order < 2:
                f = f + 2 * cross(turns[k][order], P)
                moments = moments + rotated(D, turns[k][order], back=False)
            if order == 0:
                f = f + cross(S[0], force)
                moments = moments + cross(S[0], moment) + cross(S[1], force)
            for j in path[:-1]:
                axis, along = steps[j][0]
                out[order, joints[j].v, joint.v] += dot(axis, moments) + dot(along, f)


def twisted(a: Twist, b: Twist) -> Twist:
    """a × b of motions (angular, linear), about one origin."""
    return cross(a[0], b[0]), cross(a[0], b[1]) + cross(a[1], b[0])


def _at_origin(R: Array, p: Array, pi: Array, V: Twist, A: Twist) -> list[Array]:
    """Return m, h, L, momentum P, D, force and moment of a body, about the world's origin."""
    m, L = pi[0] + np.zeros(p.shape[1]), np.zeros((3, 3))
    for value, (i, j) in zip(pi[4:], MOMENTS, strict=True):
        L[i, j] = L[j, i] = value
    h = np.tensordot(pi[1:4], R, axes=(0, 1))
    unit = np.eye(3)[:, :, None]
    L = rotated(R, np.tensordot(L, R, axes=(0, 1)), back=False)
    L += (2 * dot(h, p) + m * dot(p, p)) * unit - _outer(h, p) - _outer(p, h + m * p)
    h = h + m * p
    w, along = V
    P = m * along - cross(h, w)
    about = rotated(L, w, back=True) + cross(h, along)
    D = np.stack([cross(w, 2 * column) for column in L.transpose(1, 0, 2)], axis=1)
    trace = L[0, 0] + L[1, 1] + L[2, 2]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        D[i, j] += trace * w[k]
        D[j, i] -= trace * w[k]
    D += 2 * (dot(h, along) * unit - _outer(along, h))
    force = m * A[1] - cross(h, A[0]) + cross(w, P)
    moment = rotated(L, A[0], back=True) + cross(h, A[1]) + cross(w, about) + cross(along, P)
    return [m, h, L, P, D, force, moment]


def _outer(a: Array, b: Array) -> Array:
    """a bᵀ (3, 3, n) of vectors (3, n)."""
    return a[:, None] * b[None]
