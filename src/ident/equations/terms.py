"""The equations of motion at some samples, without multipliers; the only place where they are made.

    Γ p + E c + S s = τ + f_e − known + S s₀      A = [Γ E S] of what is unknown, b the right side

S are the sensitivities of shape parameters s at the working point s₀. In generalised coordinates v
the forces Jᵀλ are missing, and `rows.stack` expands them in time; in the independent coordinates u
all terms are projected by Zᵀ, and there are none:

    generalised     f        a joint's torque τ, ẏ = W v, is the force Wᵀτ
    independent   Zᵀ f       and there (W Z)ᵀτ, its velocity transmission      J Z = 0, W_uZ = 1

A joint of the tree has a unit row W: its torque stands in one row of all generalised forces, and no
W is written out for it. The transmission of every joint is in the state already, so that reduced
equations never evaluate the slow W of closures' own joints.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from operator import attrgetter
from typing import Any

import numpy as np
import pinocchio as pin

from ident.effects import Effect, Signals
from ident.equations.thinning import interpolated
from ident.equations.unknowns import Columns, Point
from ident.errors import MotionError
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import regressor, rigid_forces, rigid_tangents, row_spans
from ident.motion.closures import integrate
from ident.motion.state import State

STEP = 1e-3  # numerics: of the range of a shape parameter, for differences
SLIGHTLY = 1e-5  # numerics: [rad | m | per second] step along a coordinate, for differences
# work: bytes of Γ at all samples of a state, up to which it is kept unfiltered
GAMMA_BYTES = 48_000_000
MOST_BYTES = 100_000_000  # work: of derivatives that are kept with a state
FEWEST = 30  # work: samples from which one pass of derivatives is faster than several of forces
# level: share of a joint's rms speed, below which it is at rest where a log, and its spline, begin
AT_REST = 0.3
OFTEN = 3  # work: times that loads are asked for, from which on a row of Γ is kept for them
CHUNK = 4096  # work: samples whose regressor is in memory at once
WIDE = 32_768  # work: samples at which the torque of one effect is made at once
UNIT = np.ones((1, 1))  # W of a joint of the tree, in its own row
RIGID, WRENCHES = "rigid bodies", "external wrenches"
NODES, SERIES = "nodes of rows", "nodes of series"  # in a state's store: their distance
NEARBY = "nearby"  # in a memo: what the state shares with the one beside it (`equations.nearby`)


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples `part` of a state, in r coordinates: r = nv generalised or d independent ones.

    What depends on the present model is taken at `point`; `memo`, shared by all parts, stores what
    is slow to make for the whole state. The generalised coordinates of a tree are independent.
    """

    mechanism: Mechanism
    e: State
    part: slice | np.ndarray
    point: Point
    memo: dict[object, Any] = field(default_factory=dict)
    independent: bool = False

    def __len__(self) -> int:
        return len(self.e.t[self.part])

    @property
    def shape(self) -> tuple[int, int]:
        """(n, r) of forces in these coordinates."""
        return len(self), self._Z.shape[2] if self.independent else self.mechanism.model.nv

    @cached_property
    def _Z(self) -> np.ndarray:
        """The part (n, nv, d) of K⁺ = [J; W_u]⁺ that belongs to u."""
        return self.e.pinv[self.part][:, :, -self.e.leverage.shape[2] :]

    def reduce(self, f: np.ndarray) -> np.ndarray:
        """Generalised forces f (n, nv, …) in these coordinates (n, r, …); f itself where it can."""
        if not self.independent:
            return f
        if f.ndim == 2:
            return np.einsum("niu,ni->nu", self._Z, f)
        return np.asarray(self._Z.transpose(0, 2, 1) @ f)

    @cached_property
    def gamma(self) -> np.ndarray:
        """Γ (n, r, 10 · bodies); that of a state of few samples is made once and kept with it."""
        e, part, model = self.e, self.part, self.mechanism.model
        if (
            isinstance(part, np.ndarray)
            or 80 * len(e) * model.nv * (model.njoints - 1) > GAMMA_BYTES
        ):
            motion = e.q[part], e.v[part], e.a[part]
            if self.independent and len(self) and self._Z.strides[0] == 0:  # of all samples alike
                return regressor(model, *motion, self._Z[0])
            return self.reduce(regressor(model, *motion))
        stored = e.store.get("Γ", model)
        if stored is None:
            stored = [regressor(model, e.q, e.v, e.a)]
            e.store.put("Γ", model, stored)
        return self.reduce(stored[0][part])

    def rigid(self, pi: np.ndarray) -> np.ndarray:
        """Γ π (n, r) of dynamic parameters π (10 · bodies,); those of a stretch are made once."""
        e, part, model = self.e, self.part, self.mechanism.model
        if not isinstance(part, slice):
            return self.reduce(rigid_forces(model, e.q[part], e.v[part], e.a[part], pi))
        made, key = self.memo.setdefault(RIGID, {}), (part.start, part.stop, pi.tobytes())
        if key not in made and (series := self._rigid_series(pi)) is not None:
            return self.reduce(series[part])
        if key not in made:
            nearby = self.memo.get(NEARBY)
            made[key] = (
                rigid_forces(model, e.q[part], e.v[part], e.a[part], pi)
                if nearby is None
                else nearby.rigid(part, pi)
            )
        return self.reduce(made[key])

    def _rigid_series(self, pi: np.ndarray) -> np.ndarray | None:
        """Γ π (n, nv) of the whole state from nodes, where the motion is that smooth; else None."""
        e, model, made = self.e, self.mechanism.model, self.memo[RIGID]
        key = "series", pi.tobytes()
        if key not in made:
            step = series_step(e, model)

            def make(at: np.ndarray) -> np.ndarray:
                return rigid_forces(model, e.q[at], e.v[at], e.a[at], pi)

            made[key] = None if step == 1 else _from_nodes(e, step, make)
        stored: np.ndarray | None = made[key]
        return stored

    def tangents(self, part: slice, pi: np.ndarray) -> np.ndarray:
        """Return ∂(Γ π)/∂(q, v, a) (3, nv, nv, n) in other samples of the state, made once."""
        key = "tangents", part.start, part.stop, pi.tobytes()
        if key not in self.memo:
            e, model = self.e, self.mechanism.model
            self.memo[key] = rigid_tangents(model, e.q[part], e.v[part], e.a[part], pi)
        return np.asarray(self.memo[key])

    @property
    def few_tangents(self) -> bool:
        """Return whether `tangents` of the whole state pay and can be kept."""
        model, n = self.mechanism.model, len(self.e)
        return model.nq == model.nv and FEWEST <= n <= MOST_BYTES / (24 * model.nv**2)

    @property
    def dynamic_parameters(self) -> np.ndarray:
        """Dynamic parameters (10 · bodies,) with the loads on links."""
        pi = self.point.pi.copy()
        for effect in (effect for effect in self.mechanism.effects if effect.loaded_link):
            link = self.mechanism.bodies.columns(str(effect.loaded_link))
            pi[link] += self.share_of(effect) * self.point.of(effect)[0]
        return pi

    @cached_property
    def wrench(self) -> np.ndarray | None:
        """f_e (n, r) [N m | N] of measured external wrenches, if there are any."""
        return None if self.e.wrench is None else self.reduce(self.e.wrench[self.part])

    @cached_property
    def _own_rates(self) -> np.ndarray:
        # slow, so it is not asked for unless such a joint has a torque
        return self.mechanism.kinematics.own_rows(self.e.q[self.part]).rate

    @cached_property
    def _signals(self) -> dict[tuple[str, ...], Signals]:
        return {}

    def signals(self, joints: tuple[str, ...]) -> Signals:
        """The series that an effect on these joints depends on."""
        if joints not in self._signals:
            e, part = self.e, self.part
            index = self.mechanism.joint_index
            places = [index[name] for name in joints if name in index]
            # of one joint nothing is copied
            at = slice(places[0], places[0] + 1) if len(places) == 1 else places
            bare = self.generalised(part)  # no reference back to what is cached here
            self._signals[joints] = Signals(
                t=e.t[part],
                q=e.y[part][:, at],
                v=e.yd[part][:, at],
                a=e.ydd[part][:, at],
                still=e.still[at],
                extra={name: x[part] for name, x in e.extra.items()},
                present=self.point.values,
                predicted=cache(lambda: bare.predicted(joints)),
                resting=cache(lambda: bare.loads_at_rest(joints)),
                finest=e.smooth.spacing if e.smooth is not None else 0.0,
                slopes=cache(lambda: bare.load_slopes(joints)),
            )
        return self._signals[joints]

    def columns(self, effect: Effect, shape: Mapping[str, float]) -> np.ndarray:
        """E (n, arity, unknowns) of an effect at a shape, of the whole if it hangs on the past."""
        share = self.share_of(effect)
        if share != 1.0:
            if not share:
                return np.zeros((len(self), len(effect.acting), len(effect.unknowns)))
            return share * self.columns(replace(effect, per="", log=""), shape)
        is_whole = isinstance(self.part, slice) and self.part == slice(None)
        if is_whole or not effect.memory:
            return effect.columns(replace(self.signals(effect.acting), shape=shape))
        key = (effect.label, *sorted(shape.items()))
        if key not in self.memo:
            signals = self.generalised(slice(None)).signals(effect.acting)
            self.memo[key] = effect.columns(replace(signals, shape=shape))
        return self.memo[key][self.part]

    def share_of(self, effect: Effect) -> float:
        """Return how much of an effect acts in this log (`Mechanism.share_in`)."""
        return self.mechanism.share_in(effect, self.e.name)

    def add_effect(
        self, out: np.ndarray, effect: Effect, c: np.ndarray, shape: Mapping[str, float]
    ) -> None:
        """Adds the forces E c (n, r) of one effect to `out`, in these coordinates: torques E
        (n, joints, unknowns) of its joints, each spread by its W; a load of a link has the link's
        columns of Γ. For several combinations c (unknowns, k) they are (n, r, k).
        """
        if effect.loaded_link:
            link = self.mechanism.bodies.columns(effect.loaded_link)
            c = self.share_of(effect) * c
            if c.ndim == 2:
                out += self.gamma[:, :, link] @ c
            elif c.any():
                pi = np.zeros(len(self.mechanism.prior))
                pi[link] = c
                out += self.rigid(pi)
            return
        if not c.any():  # nothing, even at a shape of 0 that its columns would be divided by
            return
        E = self.columns(effect, shape)
        for i, name in enumerate(effect.acting):
            self.add_torque(out, name, E[:, i] @ c)

    def force_of(self, effect: Effect, c: np.ndarray, shape: Mapping[str, float]) -> np.ndarray:
        """E c (n, r) of one effect, of a state nearby where that is the same."""
        nearby = self.memo.get(NEARBY)
        if nearby is not None and isinstance(self.part, slice) and nearby.keeps(effect):
            return np.asarray(nearby.force(self.part, effect, c, shape))
        force = np.zeros(self.shape)
        self.add_effect(force, effect, c, shape)
        return force

    def add_sensitivity(
        self, out: np.ndarray, effect: Effect, c: np.ndarray, shape: Mapping[str, float], name: str
    ) -> None:
        """Adds ∂(E(s) c)/∂s (n, r) of one shape parameter, by central differences."""
        key = ("range", effect.label, name)
        if key not in self.memo:
            signals = self.generalised(slice(None)).signals(effect.acting)
            low, high = effect.bounds(replace(signals, shape=shape)).get(name, (0.0, 1.0))
            self.memo[key] = np.array(high - low)
        h = max(min(STEP * float(self.memo[key]), 1e-2 * abs(shape[name]) or np.inf), 1e-9)
        for sign in (1, -1):
            shifted = {**shape, name: shape[name] + sign * h}
            self.add_effect(out, effect, sign * c / (2 * h), shifted)

    def same_motion(self, other: Samples) -> bool:
        """Whether other samples are of the same motion of the same model, whatever the torques."""
        e, o = self.e, other.e
        same_state = e.q is o.q and e.v is o.v and e.a is o.a
        return same_state and self.mechanism.model is other.mechanism.model

    def generalised(self, part: slice | np.ndarray) -> Samples:
        """Other samples of the same state, in generalised coordinates."""
        return Samples(self.mechanism, self.e, part, self.point, self.memo)

    def reduced(self, part: slice | np.ndarray) -> Samples:
        """Other samples of the same state, in the independent coordinates."""
        loop = self.e.loop is not None
        return Samples(self.mechanism, self.e, part, self.point, self.memo, loop)

    @cached_property
    def informative(self) -> list[tuple[str, np.ndarray]]:
        """By effect and joint: name and (n,), false where dry friction at standstill is open."""
        joints = []
        for effect in filter(attrgetter("local"), self.mechanism.effects):
            informed = effect.informed(self.signals(effect.acting)).T
            both = zip(effect.joints, informed, strict=True)
            joints += [(name, moves) for name, moves in both if not moves.all()]
        return joints

    def lever(self, name: str) -> tuple[slice, np.ndarray]:
        """The rows in which a joint's torque works, and W (n | 1, rows) there."""
        if self.independent:
            return slice(None), self.e.leverage[self.part, self.mechanism.joint_index[name]]
        joint = self.mechanism.joint(name)
        if joint.in_tree:
            return slice(joint.index, joint.index + 1), UNIT
        return slice(None), self._own_rates[:, joint.index]

    def add_torque(self, out: np.ndarray, name: str, torque: np.ndarray) -> None:
        """Adds Wᵀτ to forces `out`: (n, r) for τ (n,), (n, r, c) for τ (n, c) of c columns."""
        rows, W = self.lever(name)
        if len(W) > 1 and W.strides[0] == 0:  # of all samples the same: most rows have none
            for row in np.flatnonzero(W[0]).tolist():
                out[:, row] += W[0, row] * torque
            return
        if torque.ndim == 2:
            W = W[:, :, None]
        out[:, rows] += W * torque[:, None]

    def measured(self, names: Iterable[str]) -> np.ndarray:
        """Σ Wᵀτ (n, r) [N m | N] of the measured torques of some driven joints."""
        total, chosen = np.zeros(self.shape), {*names}
        for i, name in enumerate(self.mechanism.driven):
            joint = self.mechanism.joint(name)
            if name in chosen and joint.in_tree and not self.independent:
                total[:, joint.index] += self.e.tau[self.part, i]
            elif name in chosen:
                self.add_torque(total, name, self.e.tau[self.part, i])
        return total

    def parts(self, without: Container[str] = ()) -> dict[str, np.ndarray]:
        """Forces (n, r) of the model at the point, by name: rigid bodies, each effect's label, but
        for some, and less the wrenches.
        """
        forces = {RIGID: self.rigid(self.point.pi)}
        for effect in self.mechanism.effects:
            if effect.label not in without and self.makes_torque(effect):
                forces[effect.label] = self.force_of(effect, *self.point.of(effect))
        if self.wrench is not None:
            forces[WRENCHES] = -self.wrench
        return forces

    def makes_torque(self, effect: Effect) -> bool:
        """Return whether an effect has a torque, all of whose shapes are known."""
        names = (effect.full[parameter.name] for parameter in effect.shapes)
        return bool(effect.unknowns) and all(name in self.point.values for name in names)

    def coordinates_of(self, name: str) -> list[int]:
        """Return the coordinates in which one of `parts`, by its name, may differ from zero."""
        effect = next((x for x in self.mechanism.effects if x.label == name), None)
        if effect is not None and not self.point.of(effect)[0].any():
            return []
        if effect is None or effect.loaded_link or self.e.loop is not None:
            return [*range(self.e.leverage.shape[2])]
        return sorted({self.mechanism.joint(joint).index for joint in effect.acting})

    # --- predictions of the present model, none of which sees the measured torque of the joint ----

    def forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Generalised forces (n, nv): bodies with their loads, less wrenches; explicit effects."""
        key = ("explicit effects",)
        if key not in self.memo:
            effects = [x for x in self.mechanism.effects if not (x.implicit or x.loaded_link)]
            self.memo[key] = self._summed(effects)
        return self._bodies()[self.part], self.memo[key][self.part]

    def multipliers(self) -> np.ndarray:
        """λ = −(K⁺ᵀ f)_λ (n, m) [N | N m], f less the torques of drives that are not in u."""
        m = len(self.mechanism.kinematics.multipliers)
        f = sum(self.forces()) - self.surplus()
        return -np.einsum("nij,ni->nj", self.e.pinv[self.part][:, :, :m], f)

    def surplus(self) -> np.ndarray:
        """Generalised forces (n, nv) of the drives that are not in u."""
        others = {*self.mechanism.driven} - {*self.e.independent}
        return self.generalised(self.part).measured(others)

    def predicted(self, joints: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
        """(torque, load), both (n, joints) [N m | N]; zero at passive joints.

        load  f_j = Γ_j π − f_e, π with loads on links       torque  τ̂_j = f_j + Σ E_j c of other
        effects that are explicit; in a closure's own joint both are |λ|, the size of its force.
        """
        e = self.e
        if e.loop is None:  # of a tree: each joint's own row
            load = self._loads(joints)[self.part]
            return load + self._effects_on(joints)[self.part], load
        both = *self.forces(), self.surplus()
        pinv = e.pinv[self.part]
        return joint_loads(self.mechanism, joints, e.independent, pinv, *both, e.tau[self.part])

    def _loads(self, joints: tuple[str, ...]) -> np.ndarray:
        """Loads (n, joints) of a tree in the whole state."""
        key = "loads", joints
        if key not in self.memo:
            at = [self.mechanism.joint(name).index for name in joints]
            made = {number for *_, number in self.memo.get(RIGID, {})}  # bodies' forces, by π
            whole = NEARBY in self.memo or self.point.pi.tobytes() in made
            rows = [] if whole else [self._gamma_row(index) for index in at]
            if rows and all(row is not None for row in rows):
                pi, spans = self.dynamic_parameters, row_spans(self.mechanism.model)
                both = zip(rows, (spans[index] for index in at), strict=True)
                loads = np.stack([row @ pi[span] for row, span in both if row is not None], axis=1)
                wrench = self.e.wrench
                self.memo[key] = loads if wrench is None else loads - wrench[:, at]
            else:
                self.memo[key] = self._bodies()[:, at]
        return np.asarray(self.memo[key])

    def _gamma_row(self, index: int) -> np.ndarray | None:
        """Γ of one row (n, its span) of the whole state, once it is asked for the third time: a
        search of shapes asks for the load with ever other parameters. None before, or if too large.
        """
        e, model, asked = self.e, self.mechanism.model, ("asked for Γ", index)
        key, times = ("Γ", index), e.store.get(asked, model)
        if times is None:
            times = [np.zeros(1)]
            e.store.put(asked, model, times, always=True)
        times[0] += 1
        stored = e.store.get(key, model)
        if stored is None and times[0] >= OFTEN:
            span, n = row_spans(model)[index], len(e)
            if not e.store.fits_always(8 * n * (span.stop - span.start)):
                return None
            parts = (slice(i, min(i + CHUNK, n)) for i in range(0, n, CHUNK))
            pieces = [regressor(model, e.q[x], e.v[x], e.a[x])[:, index, span] for x in parts]
            stored = [np.concatenate(pieces)]
            e.store.put(key, model, stored, always=True)
        return None if stored is None else np.asarray(stored[0])

    def _bodies(self) -> np.ndarray:
        """Forces (n, nv) of the whole state's bodies with their loads, less wrenches."""
        key = ("bodies",)
        if key not in self.memo:
            loads = [x for x in self.mechanism.effects if x.loaded_link and not x.implicit]
            self.memo[key] = self._summed(loads, bodies=True)
        return np.asarray(self.memo[key])

    def _effects_on(self, joints: tuple[str, ...]) -> np.ndarray:
        """Forces (n, joints) of the whole state's other explicit effects, in rows of a tree."""
        key = "effects on", joints
        if key not in self.memo:
            effects = [
                x
                for x in self.mechanism.effects
                if not (x.implicit or x.loaded_link or (x.local and not {*x.joints} & {*joints}))
            ]
            total = np.zeros((len(joints), len(self.e)))
            for row, name in zip(total, joints, strict=True):
                for effect in effects:
                    if name in effect.acting:
                        self._add_torque_of(row, effect, name)
            self.memo[key] = total.T
        return np.asarray(self.memo[key])

    def _add_torque_of(self, out: np.ndarray, effect: Effect, joint: str) -> None:
        """Add the torque E c (n,) of one effect at one joint in the whole state."""
        c, shape = self.point.of(effect)
        if not effect.unknowns or len(shape) < len(effect.shapes) or not c.any():
            return
        nearby, place = self.memo.get(NEARBY), effect.acting.index(joint)
        if nearby is not None and nearby.keeps(effect):
            out += nearby.torque(effect, place, c, shape)
            return
        for start in range(0, len(out), WIDE):
            s = self.generalised(slice(start, min(start + WIDE, len(out))))
            out[s.part] += s.columns(effect, shape)[:, place] @ c

    def torque_of(self, effect: Effect, joint: str) -> np.ndarray:
        """Return the torque E c (n,) of one effect at one of the joints at which it acts, in the
        whole state.
        """
        torque = np.zeros(len(self.e))
        self._add_torque_of(torque, effect, joint)
        return torque

    def _summed(self, effects: Sequence[Effect], bodies: bool = False) -> np.ndarray:
        """Generalised forces (n, nv) of some effects, and bodies, in the whole state."""
        n = len(self.e)
        total = np.zeros((n, self.mechanism.model.nv))
        for start in range(0, n, CHUNK):
            s = self.generalised(slice(start, min(start + CHUNK, n)))
            if bodies:
                total[s.part] += s.rigid(self.point.pi)
            for effect in effects:
                c, shape = self.point.of(effect)
                if effect.unknowns and len(shape) == len(effect.shapes):
                    total[s.part] += s.force_of(effect, c, shape)
            if bodies and s.wrench is not None:
                total[s.part] -= s.wrench
        return total

    @property
    def begins_at_rest(self) -> bool:
        """Whether all joints are at rest as the log begins: splines end there, so roughly."""
        e = self.e
        slow = AT_REST * np.sqrt((e.yd**2).mean(axis=0))
        return bool(not e.poses and (np.abs(e.yd[0]) <= np.maximum(slow, e.still)).all())

    def at_first_rest(self) -> Samples:
        """Return the first sample, at rest, in the independent coordinates."""
        first = self.e.at_samples(slice(0, 1))
        names = ("v", "a", "yd", "ydd")
        still = replace(first, **{name: np.zeros_like(getattr(first, name)) for name in names})
        return replace(self, e=still, part=slice(None), memo={}).reduced(slice(None))

    def loads_at_rest(self, joints: tuple[str, ...]) -> np.ndarray | None:
        """Loads (joints,) [N m | N] before the log; None where it does not begin at rest."""
        if not self.begins_at_rest:
            return None
        key = "loads at rest", joints
        if key not in self.memo:
            self.memo[key] = self.at_first_rest().predicted(joints)[1][0]
        return np.asarray(self.memo[key])

    def load_slopes(self, joints: tuple[str, ...]) -> np.ndarray:
        """(3, n, joints) slopes of the torque of the bodies along q, v and a of each joint alone.

        Raises:
            MotionError: of a joint of a loop that is not independent.
        """
        key = "load slopes", joints
        if key not in self.memo:
            self.memo[key] = self._load_slopes(joints)
        return np.asarray(self.memo[key][:, self.part])

    def _load_slopes(self, joints: tuple[str, ...]) -> np.ndarray:
        """The same of the whole state."""
        e, pi, model = self.e, self.dynamic_parameters, self.mechanism.model
        if e.loop is None and self.few_tangents:
            at = [self.mechanism.joint(name).index for name in joints]
            parts = (slice(i, min(i + CHUNK, len(e))) for i in range(0, len(e), CHUNK))
            every = [self.tangents(part, pi)[:, at, at].transpose(0, 2, 1) for part in parts]
            return np.concatenate(every, axis=1)
        slopes = np.zeros((3, len(e), len(joints)))
        now = None if self.few_tangents else rigid_forces(model, e.q, e.v, e.a, pi)
        for i, name in enumerate(joints):
            if e.loop is None:
                Z = np.zeros_like(e.v)
                Z[:, self.mechanism.joint(name).index] = 1.0
            elif name in e.independent:
                Z = np.ascontiguousarray(
                    e.pinv[:, :, e.independent.index(name) - len(e.independent)]
                )
            else:
                raise MotionError(
                    f"{name}: what swings or flies behind it is known of joints alone in whose "
                    f"coordinates errors are compared ({', '.join(e.independent)}); leave out the "
                    f"spring or play of {name}"
                )
            if now is None:
                felt = np.flatnonzero(Z.any(axis=0))
                for start in range(0, len(e), CHUNK):
                    part = slice(start, min(start + CHUNK, len(e)))
                    D, of_part = self.tangents(part, pi)[:, felt][:, :, felt], Z[part, felt].T
                    slopes[:, part, i] = ((D * of_part).sum(axis=2) * of_part).sum(axis=1)
                continue
            turned, faster = integrate(model, e.q, SLIGHTLY * Z), e.v + SLIGHTLY * Z
            shifted = (turned, e.v, e.a), (e.q, faster, e.a), (e.q, e.v, e.a + Z)
            for k, state in enumerate(shifted):
                rise = rigid_forces(model, *state, pi) - now
                slopes[k, :, i] = np.einsum("ni,ni->n", Z, rise) / (1.0 if k == 2 else SLIGHTLY)
        return slopes


def _from_nodes(e: State, step: int, make: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Return a series (n, c) of a state, which `make` gives at some samples, from one in `step`."""
    runs, rest = e.segments(), np.flatnonzero(~e.usable)
    pieces = [interpolated(make, run, step) for run in runs]
    out = np.empty((pieces[0].shape[1], len(e))).T
    for run, piece in zip(runs, pieces, strict=True):
        out[run] = piece
    if len(rest):
        out[rest] = make(rest)
    return out


def series_step(e: State, model: pin.Model) -> int:
    """Return the distance of nodes from which series of a state are made at all samples: that of
    its rows, if the accelerations, the roughest of the motion, show no difference; else 1.
    """
    if (stored := e.store.get(SERIES, model)) is not None:
        return int(stored[0][0])
    of_rows, step = e.store.get(NODES, model), 1
    if of_rows is not None and of_rows[0][0] > 1 and e.usable.any():
        step, tolerance = int(of_rows[0][0]), of_rows[0][1]
        off = np.abs(_from_nodes(e, step, lambda at: e.a[at]) - e.a)
        size = np.sqrt((e.a**2).mean(axis=0))
        step = step if (off.max(axis=0) <= tolerance * size).all() else 1
        e.store.put(SERIES, model, [np.array([step])], always=True)
    return step


def joint_loads(
    mechanism: Mechanism,
    joints: Sequence[str],
    independent: tuple[str, ...],
    pinv: np.ndarray | None,
    rigid: np.ndarray,
    others: np.ndarray,
    known: np.ndarray,
    tau: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return (torque, load), both (n, joints) [N m | N], as `Samples.predicted`: from forces of
    bodies and of effects, and those `known` of surplus drives (n, nv), the torques of all drives
    (n, driven), and K⁺ (n, nv, m + d), None for a tree.
    """
    torque, load = np.zeros((2, len(rigid), len(joints)))
    for i, name in enumerate(joints):
        joint = mechanism.joint(name)
        if pinv is None:
            load[:, i] = rigid[:, joint.index]
            torque[:, i] = load[:, i] + others[:, joint.index]
        elif name in independent:
            extract = pinv[:, :, independent.index(name) - len(independent)]
            load[:, i] = np.einsum("ni,ni->n", extract, rigid - known)
            torque[:, i] = load[:, i] + np.einsum("ni,ni->n", extract, others)
        elif name in mechanism.driven:
            torque[:, i] = load[:, i] = tau[:, mechanism.driven.index(name)]
        elif not joint.in_tree:
            extract = pinv[:, :, mechanism.kinematics.forces_of(name)]
            force = np.einsum("nij,ni->nj", extract, rigid + others - known)
            torque[:, i] = load[:, i] = np.linalg.norm(force, axis=1)
    return torque, load


@dataclass(frozen=True, eq=False)
class Terms:
    """The equations of n samples, r rows each."""

    A: np.ndarray  # (n, r, k), the columns of the unknowns x
    b: np.ndarray  # (n, r) [N m | N], the known side
    tau: np.ndarray  # (n, r) [N m | N], the measured torques alone


def effect_terms(
    s: Samples, columns: Columns, thinned: bool = False, without: Container[str] = ()
) -> Terms:
    """The equations without Γ: A (n, r, k − rigid) holds the columns of effects only; `thinned`:
    without those that `smooth_columns` has, and `without` those of some, by label.
    """
    tau = s.measured(s.mechanism.driven)
    b = tau.copy() if s.wrench is None else tau + s.wrench
    n, r = s.shape
    before = len(columns.rigid)
    # columns stand whole in memory: that is how they are filled, filtered and factored
    A = np.zeros((r, len(columns) - before, n)).transpose(2, 0, 1)
    for effect, places in columns.effects:
        if effect.corrects or effect.loaded_link:
            continue
        u = len(effect.unknowns)
        unknown = places[:u] >= 0
        skipped = effect.label in without or (thinned and is_smooth(effect))
        if skipped and unknown.all():
            continue
        c, shape = s.point.of(effect)
        if unknown.any() and not skipped:
            at = places[:u][unknown] - before  # neighbours in x: a view of A can be added to
            s.add_effect(A[:, :, at[0] : at[-1] + 1], effect, np.eye(u)[:, unknown], shape)
        if not unknown.all():
            s.add_effect(b, effect, -np.where(unknown, 0.0, c), shape)
        names = (parameter.name for parameter in effect.shapes)
        for place, name in zip(places[u:], names, strict=True):
            if place >= 0:  # ∂(E c)/∂s
                s.add_sensitivity(A[:, :, place - before], effect, c, shape, name)
                b += A[:, :, place - before] * shape[name]
    return Terms(A, b, tau)


def is_plain(effect: Effect) -> bool:
    """Whether all columns of an effect are functions of the sample's motion alone."""
    explicit = not (effect.corrects or effect.loaded_link or effect.memory or effect.implicit)
    return explicit and not effect.shapes


def is_smooth(effect: Effect) -> bool:
    """Whether these are smooth."""
    return effect.smooth and is_plain(effect)


def smooth_places(columns: Columns) -> np.ndarray:
    """Return the places in x, ascending, of the unknowns whose columns are smooth beside Γ."""
    places = [places for effect, places in columns.effects if is_smooth(effect)]
    every = np.concatenate([np.empty(0, dtype=int), *places])
    return np.sort(every[every >= 0])


def smooth_columns(s: Samples, columns: Columns, places: np.ndarray) -> np.ndarray:
    """Return the columns (n, r, u) of the unknowns at `smooth_places`."""
    n, r = s.shape
    A = np.zeros((r, len(places), n)).transpose(2, 0, 1)
    for effect, its in columns.effects:
        if is_smooth(effect) and (its >= 0).any():
            at = np.searchsorted(places, its[its >= 0])
            s.add_effect(A[:, :, at[0] : at[-1] + 1], effect, np.eye(len(its))[:, its >= 0], {})
    return A


def with_bodies(
    columns: Columns,
    point: Point,
    gamma: Sequence[np.ndarray],
    A: np.ndarray,
    b: np.ndarray,
    spans: Sequence[slice] = (),
    share_of: Callable[[Effect], float] = lambda effect: 1.0,
) -> tuple[np.ndarray, np.ndarray]:
    """A (n, r, k) and b (n, r) with the rigid bodies, from those of the effects alone.

    `gamma` holds, for each row, the columns `spans` of Γ (n, span), by default all of them.
    """
    n, r = b.shape
    columns_of_all = np.zeros((r, len(columns), n)).transpose(2, 0, 1)
    columns_of_all[:, :, len(columns.rigid) :] = A
    known = {int(i): float(x) for i, x in zip(columns.known, columns.known_values, strict=True)}
    loads, shares = [effect for effect, _ in columns.effects if effect.loaded_link], {}
    for (link, places), effect in zip(columns.loads, loads, strict=True):
        for i, place, x in zip(link, places, point.of(effect)[0], strict=True):
            shares[int(place)] = share_of(effect)
            if place < 0:
                known[i] = known.get(i, 0.0) + share_of(effect) * x
    b = b.copy() if known else b
    for row, columns_of_row in enumerate(gamma):
        first, stop = (spans[row].start, spans[row].stop) if spans else (0, columns_of_row.shape[1])
        for column, place in zip(*columns.of_gamma, strict=True):
            if first <= column < stop:
                share = shares.get(int(place), 1.0)
                columns_of_all[:, row, place] += share * columns_of_row[:, column - first]
        for column, value in known.items():
            if first <= column < stop and value:
                b[:, row] -= columns_of_row[:, column - first] * value
    return columns_of_all, b


def unbalanced(s: Samples) -> np.ndarray:
    """b − A x (n, r) at the working point."""
    return s.measured(s.mechanism.driven) - sum(s.parts().values())


def residual(at: Samples) -> np.ndarray:
    """r = b − A x (n, d) of a whole state, in the independent coordinates."""
    if "residual" not in at.memo:
        n = len(at.e)
        parts = (at.reduced(slice(i, min(i + CHUNK, n))) for i in range(0, n, CHUNK))
        at.memo["residual"] = np.concatenate([*map(unbalanced, parts)])
    return at.memo["residual"]
