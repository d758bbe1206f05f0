"""Rows of the equations, filtered, of states and mechanisms that effects have corrected.

    y → y + δy     τ(t) → τ(t + d) + k g(q)     g → Rᵀ g     placements + Δ     q → q + K⁺ [C λ; 0]

A corrected state is one like any other; no equation needs to know of it. The columns of a
correction's shapes are S = −∂r/∂s, r = b − A x, by differences over corrections at s and s + h.

Rows of the reduced equations: one an independent coordinate and sample, no multipliers.

    Zᵀ (Γ p + E c) = Zᵀ (τ + f_e) − known        J Z = 0, W_u Z = 1

With one free multiplier a sample, these rows and the stack [Γ E | Jᵀ] have the same solution. Row u
is the error of the predicted torque of the independent joint u, which is what is compared.

Or the paper's stack [Γ E | JᵀB] (eq. 7-8): all rows, multipliers expanded in a time basis:

    Γ p + E c + Jᵀ B a = τ + f_e − known          λ(t) = B(t) a
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Any

import numpy as np

from ident.effects import Correction, Effect
from ident.equations.filter import STANDING, STICKING, Decimator, filtered_windows
from ident.equations.nearby import linearized
from ident.equations.terms import (
    NEARBY,
    NODES,
    RIGID,
    Samples,
    Terms,
    effect_terms,
    is_plain,
    series_step,
    smooth_columns,
    smooth_places,
    unbalanced,
    with_bodies,
)
from ident.equations.thinning import NodeSeries, Thinning, agreeing_step
from ident.equations.twists import Twist, twists_of, with_motors
from ident.equations.unknowns import Columns, Point
from ident.errors import MotionError
from ident.information.cubic import late
from ident.information.evidence import PARSIMONY
from ident.information.time_bases import Basis, Chunk
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import rigid_forces, row_spans, supports
from ident.motion.closures import integrate
from ident.motion.signals import runs
from ident.motion.state import State

WIDER = 3.0  # numerics: times the rows' cut-off: passes all that the rows' filter passes
OF_NOISE = 1e-3  # numerics: share of the torques' noise by which thinned rows may differ
EXACT = 1e-9  # numerics: share of a column by which they may differ where there is no noise
LOOSEST = 1e-6  # numerics: and the most, however large the noise is
RUNS_AWAY = 3.0  # numerics: times the pass before that one brings where a swing grows by passes
# work: of links that swing, over the load of their own motion: in a tree, and in a loop, whose load
# changes more with its position
PASSES, LOOP_PASSES = 2, 6
SETTLED = 1e-10  # numerics: of all steps, below which a further pass brings nothing
STEP = 1e-5  # numerics: of the range of a shape parameter: corrections are smooth in their shapes
EARLIER = "state before"  # in the memory of samples


def corrected(base: Samples, cutoff: float | None, only: Effect | None = None) -> Samples:
    """A whole state as correcting effects (or `only` one) make it at the point of `base`."""
    mechanism, e = base.mechanism, base.e
    corrections, every = [], mechanism.effects
    twisting = list[tuple[Effect, dict[str, float]]]()
    if only:  # the last one as a rule, and drives that it is in
        same = tuple(x for x in every[::-1] if x.kind == only.kind and x.label == only.label)[:1]
        every = tuple(x for x in every if x in same or in_drive(only, x))
    for effect in every:
        if not effect.corrects or (shape := _acting_shape(base, effect)) is None:
            continue
        what = effect.correction(replace(base.signals(effect.acting), shape=shape))
        corrections.append((effect.margin, what))
        swings = any(x.ndim == 2 and name in e.logged for name, x in what.twist.items())
        twisting += [(effect, shape)] if swings else []
        mechanism = mechanism.corrected(what)
    every_correction = [what for _, what in corrections]
    steps = dict[str, np.ndarray]()  # (3, n) of logged joints
    for margin, what in corrections:
        for name, d in what.delay.items() if not e.poses else ():
            tau, channel = e.tau.copy(), mechanism.driven.index(name)
            tau[:, channel] = late(e.t, e.tau[:, channel], -d)  # read at t + d, without the ends
            inside = (e.t >= e.t[0] + margin) & (e.t <= e.t[-1] - margin)
            e = e.with_torques(tau, e.usable & inside)
        for name, d in what.position_delay.items() if not e.poses else ():
            if name in e.logged:
                logged = e.known(mechanism, (name,))[:, :, 0]
                now = logged + steps.get(name, 0.0)
                steps[name] = late(e.t, now.T, -d).T - logged
                inside = (e.t >= e.t[0] + margin) & (e.t <= e.t[-1] - margin)
                e = replace(e, usable=e.usable & inside)
        for name, torque in what.torque.items():
            tau = e.tau.copy()
            tau[:, mechanism.driven.index(name)] = torque
            e = e.with_torques(tau)
        for name, dq in what.dq.items():
            if name in e.logged:  # the closures place the others
                steps[name] = steps.get(name, 0.0) + _rates(e, dq, cutoff)
        if what.since:
            e = replace(e, usable=e.usable & (e.poses | (e.t >= e.t[0] + what.since)))
        for name, twist in what.twist.items():
            if name in e.logged:
                steps[name] = steps.get(name, 0.0) + _rates(e, twist, cutoff)
    moves = (
        what.dq or what.position_delay or what.twist or what.displaced for what in every_correction
    )
    if any(moves):
        # once: all are of the data as logged
        motors, key = e, _numbers_of(corrections, e.usable)
        stored = base.e.store.state(key, mechanism.model) if key else None
        if stored is not None:
            e = stored.with_torques(e.tau).with_rest(e.rest)
        else:
            e = with_motors(mechanism, e.stepped(mechanism, steps), motors, every_correction)
            if key:
                base.e.store.put_state(key, mechanism.model, e)
        # loads of the links, where they are by now; not where a swing, hardly damped in a loop,
        # would grow by each pass
        passes = (PASSES if e.loop is None else LOOP_PASSES) if twisting else 0
        size = _size(steps) if twisting else 0.0
        for _ in range(passes):
            changes = dict[str, np.ndarray]()
            for effect, at in twisting:
                (name,) = effect.joints
                further = _twisted_further(base, mechanism, e, motors, effect, at)
                changes[name] = changes.get(name, 0.0) + further
            last, size = size, _size(changes)
            if size > RUNS_AWAY * last:
                break
            steps |= {name: steps[name] + change for name, change in changes.items()}
            e = with_motors(mechanism, motors.stepped(mechanism, steps), motors, every_correction)
            if size <= SETTLED * _size(steps):
                break
    memo = _memo(base, mechanism, e)
    for _, what in corrections:
        for name, d in what.late.items() if len(e) > 1 else ():
            now = Samples(mechanism, e, slice(None), base.point, memo)
            earlier = _earlier(now, base, d, name)
            torque, before = (s.predicted((name,))[0][:, 0] for s in (now, earlier))
            tau = e.tau.copy()
            tau[:, mechanism.driven.index(name)] += torque - before
            e = e.with_torques(tau)
        if what.compensated:
            e = e.with_torques(e.tau + what.compensated * holding_torques(base.mechanism, e))
        if what.clock:
            f = 1 + what.clock
            e = replace(e, v=e.v / f, yd=e.yd / f, still=e.still / f)
            e = replace(e, a=e.a / f**2, ydd=e.ydd / f**2)
            memo = {}
        for name, C in what.gap.items():  # q + K⁺ [C λ; 0], exact to first order in C
            forces = mechanism.kinematics.forces_of(name)
            gap = C * base.multipliers()[:, forces]
            step = np.einsum("nij,nj->ni", e.pinv[:, :, forces], gap)
            transmits = np.stack([_rates(e, x, cutoff) for x in step.T], axis=2)
            q = integrate(mechanism.model, e.q, transmits[0])
            closed = e.at(mechanism, motion=(q, e.v + transmits[1], e.a + transmits[2]))
            e, memo = with_motors(mechanism, closed, e, every_correction), {}
    if e is base.e and mechanism is base.mechanism:
        return base
    return Samples(mechanism, e, slice(None), base.point, _memo(base, mechanism, e))


def _numbers_of(
    corrections: Sequence[tuple[float, Correction]], usable: np.ndarray
) -> tuple[object, ...]:
    """Return the numbers of corrections by which a state is moved, of samples that are usable; ()
    where it is moved by series too, or in another model.
    """
    numbers: list[object] = [usable.tobytes()]
    for _, what in corrections:
        by_series = what.twist or any(np.ndim(x) for x in what.dq.values())
        if by_series or what.displaced or any(what.tilt):
            return ()
        numbers += [tuple(what.dq.items()), tuple(what.position_delay.items())]
    return tuple(numbers)


def _size(steps: Mapping[str, np.ndarray]) -> float:
    """Return the norm of all of some steps."""
    return float(np.linalg.norm([np.linalg.norm(step) for step in steps.values()]))


def _acting_shape(base: Samples, effect: Effect) -> dict[str, float] | None:
    """Return the shape of a correcting effect in a log; None where it corrects nothing."""
    _, shape = base.point.of(effect)
    if effect.supplies_torque and not base.e.extra.keys() >= {*effect.reads()}:
        return None  # a motion that was made up has no commands
    if len(shape) < len(effect.shapes):
        return None
    if not any(shape.values()) and not (effect.margin or effect.by_load):
        return None
    share = base.share_of(effect)
    return {name: share * value for name, value in shape.items()} if share else None


def twist_of(base: Samples, effect: Effect, cutoff: float | None) -> np.ndarray:
    """Return by what the position, rate and acceleration (3, n) of its joint's link are changed by
    an effect that twists it, at the point of `base`.
    """
    shape, (name,) = _acting_shape(base, effect), effect.joints
    if shape is None or name not in base.e.logged:
        return np.zeros((3, len(base.e)))
    what = effect.correction(replace(base.signals(effect.acting), shape=shape))
    return _rates(base.e, what.twist.get(name, 0.0), cutoff)


def holding_torques(mechanism: Mechanism, e: State) -> np.ndarray:
    """Return the drives' torques (n, driven) that hold the given bodies against gravity."""
    rest = np.zeros_like(e.v)
    forces = rigid_forces(mechanism.model, e.q, rest, rest, mechanism.prior)
    if e.loop is not None:  # Zᵀ g
        count = e.leverage.shape[2]
        forces = np.einsum("niu,ni->nu", e.pinv[:, :, -count:], forces)
    return e.drive_torques(forces, [mechanism.joint_index[name] for name in mechanism.driven])


def _earlier(now: Samples, base: Samples, d: float, name: str) -> Samples:
    """Return samples of the state d [s] before, so that dry friction jumps there as it does where
    positions are read as much earlier, and forces are as near to those now as they are there; the
    load of the joint `name` of a tree is interpolated where it would take a pass, if series of this
    motion may be made of fewer samples than there are.
    """
    e = now.e
    stored = base.memo.setdefault(EARLIER, {}) if base.same_motion(now) else {}
    if d not in stored:
        known = e.known(now.mechanism).transpose(1, 0, 2)  # by sample
        shifted = late(e.t, known.reshape(len(e), -1), d).reshape(known.shape)
        earlier = replace(now, e=e.at(now.mechanism, shifted.transpose(1, 0, 2)), memo={})
        stored[d] = linearized(earlier, base)
    made: Samples = stored[d]  # corrections of torques change no force of the model
    whole = e.loop is None and e.wrench is None and len(e.segments()) == 1
    if NEARBY not in made.memo and whole and series_step(e, now.mechanism.model) > 1:
        load = now.predicted((name,))[1]
        made.memo.setdefault(("loads", (name,)), late(e.t, load, d))
    return replace(now, e=made.e, memo=made.memo)


def in_drive(only: Effect, effect: Effect) -> bool:
    """Return whether a drive supplies a torque that another effect corrects."""
    return only.through_drives and effect.supplies_torque and effect.joints[0] in only.joints


def _twisted_further(
    base: Samples,
    mechanism: Mechanism,
    e: State,
    motors: State,
    effect: Effect,
    shape: Mapping[str, float],
) -> np.ndarray:
    """Return by what the coordinate, rate and acceleration (3, n) of a link change which swings
    behind its motor and has the load L of its own motion: in a step of Newton's method that is
    L + G δ + C δ̇ + M δ̈, with the twist δ so far.
    """
    (name,) = effect.joints
    at, place = mechanism.joint(name).index, mechanism.joint_index[name]
    now = np.stack([x[:, at] for x in (e.q, e.v, e.a)])
    twist = np.stack([y[:, place] for y in (motors.y, motors.yd, motors.ydd)]) - now
    signals = base.signals(effect.acting)
    of_links = Samples(mechanism, e, slice(None), base.point, _memo(base, mechanism, e))
    by_twist = (signals.load_slopes[:, :, 0] * twist).sum(axis=0)
    load = of_links.predicted((name,))[1] + by_twist[:, None]
    rest = of_links.loads_at_rest((name,))
    if rest is not None:
        rest = rest + signals.load_slopes[0, 0, 0] * twist[0, 0]
    again = replace(signals, shape=shape, predicted=lambda: (load, load), resting=lambda: rest)
    return np.asarray(effect.correction(again).twist[name] + twist)


def _memo(base: Samples, mechanism: Mechanism, e: State) -> dict[object, Any]:
    """Return what a corrected state shares with the one of `base`."""
    same = base.same_motion(Samples(mechanism, e, slice(None), base.point))
    return {RIGID: base.memo.setdefault(RIGID, {})} if same else {}


def perturbed(
    base: Samples, effect: Effect, name: str, cutoff: float | None, only: Effect | None = None
) -> tuple[float, Samples]:
    """h [the shape's unit] and the state corrected with one shape of an effect at s + h."""
    h, further = slightly_further(base, effect, name)
    return h, corrected(further, cutoff, only)


def slightly_further(base: Samples, effect: Effect, name: str) -> tuple[float, Samples]:
    """h [the shape's unit] and the samples at the point where one shape of an effect is s + h."""
    _, shape = base.point.of(effect)
    low, high = effect.bounds(replace(base.signals(effect.acting), shape=shape))[name]
    h = STEP * (high - low)
    point = base.point.with_values({effect.full[name]: shape.get(name, 0.0) + h})
    return h, replace(base, point=point)


def _rates(e: State, dq: np.ndarray | float, cutoff: float | None) -> np.ndarray:
    """δy, δẏ, δÿ (3, n) of a correction, without what is far above the rows' cut-off; of one that
    knows its rates, these.
    """
    n = len(e)
    if np.ndim(dq) == 2:
        return np.asarray(dq)
    if np.ndim(dq) == 0 or n < 2 or e.poses:  # of one sample no rate is known
        return np.stack([np.broadcast_to(dq, n), np.zeros(n), np.zeros(n)])
    wide = WIDER * cutoff if cutoff and WIDER * cutoff < 0.5 * e.rate else None
    decimator, x = Decimator.of(wide, e.rate), np.asarray(dq, dtype=float)
    if decimator.taps is not None:
        x = np.convolve(np.pad(x, decimator.half, mode="edge"), decimator.taps, mode="valid")
    rate = np.gradient(x, 1 / e.rate)
    return np.stack([x, rate, np.gradient(rate, 1 / e.rate)])


def drive_slopes(bare: Samples, columns: Columns) -> list[tuple[int, float, str, np.ndarray]]:
    """Return of each unknown shape of a drive but its scale: its place in x, its value s, the joint
    and the slope (n,) of its torque, which is all that such a shape corrects.
    """
    slopes = []
    for effect, places in columns.effects:
        if not effect.supplies_torque or not bare.e.extra.keys() >= {*effect.reads()}:
            continue
        shape = bare.point.of(effect)[1]
        signals = replace(bare.signals(effect.acting), shape=shape)
        if len(shape) < len(effect.shapes):
            continue
        (name,), now = effect.joints, effect.correction(signals).torque
        for parameter, place in zip(effect.shapes, places, strict=True):
            if place < 0 or parameter.name == effect.scale:
                continue
            value = shape[parameter.name]
            h = STEP * max(1.0, abs(value))  # a damping, in which the torque is linear
            further = replace(signals, shape={**shape, parameter.name: value + h})
            after = effect.correction(further).torque
            slopes.append((int(place), value, name, (after[name] - now[name]) / h))
    return slopes


@dataclass(frozen=True, eq=False)
class Scene:
    """One state with its corrections at the working point."""

    samples: Samples  # corrected mechanism and state, and values of all parameters
    columns: Columns  # the unknowns
    # for every unknown shape of a correcting effect: its place in x, its value s, h, and the
    # state at s + h
    perturbed: tuple[tuple[int, float, float, Samples], ...] = ()
    # for every unknown scale of a drive: its place in x, and the drive with its shapes
    scales: tuple[tuple[int, Effect, Mapping[str, float]], ...] = ()
    # for every other unknown shape of a drive in a tree: its place in x, its value s, the joint and
    # the slope (n,) of its torque over s
    slopes: tuple[tuple[int, float, str, np.ndarray], ...] = ()
    # what unknowns of bodies do by the springs that they twist, one a spring
    twists: tuple[Twist, ...] = ()

    @classmethod
    def of(
        cls,
        mechanism: Mechanism,
        columns: Columns,
        e: State,
        point: Point | None = None,
        cutoff: float | None = None,
    ) -> Scene:
        """The scene of a state; `cutoff` [Hz] is that of the rows' filter."""
        check_needs(mechanism, e.name, e.extra)
        bare = Samples(mechanism, e, slice(None), point or Point.prior(mechanism))
        slopes = [] if mechanism.closures else drive_slopes(bare, columns)
        sloped = {place for place, *_ in slopes}
        shifted = [
            (int(place), bare.point.of(effect)[1].get(parameter.name, 0.0),
             *perturbed(bare, effect, parameter.name, cutoff))
            for effect, places in columns.effects if effect.corrects
            for parameter, place in zip(effect.shapes, places, strict=True)
            if place >= 0 and parameter.name != effect.scale and place not in sloped
            and bare.share_of(effect)
        ]  # fmt: skip
        scales = [
            (int(place), effect, bare.point.of(effect)[1])
            for effect, places in columns.effects
            if effect.scale
            for parameter, place in zip(effect.shapes, places, strict=True)
            if place >= 0 and parameter.name == effect.scale
        ]
        at = corrected(bare, cutoff)
        twists = twists_of(bare, at, columns)
        return cls(at, columns, tuple(shifted), tuple(scales), tuple(slopes), twists)

    @property
    def mechanism(self) -> Mechanism:
        """Corrected."""
        return self.samples.mechanism

    @property
    def e(self) -> State:
        """Corrected."""
        return self.samples.e

    @property
    def point(self) -> Point:
        """The working point."""
        return self.samples.point

    def effects(self, s: Samples, thinned: bool = False, without: Container[str] = ()) -> Terms:
        """The equations of some samples without Γ, with the sensitivities S of corrections;
        `thinned` and `without` as in `effect_terms`.
        """
        terms = effect_terms(s, self.columns, thinned, without)
        before, r = len(self.columns.rigid), None
        for place, value, h, other in self.perturbed:
            shifted = replace(s, mechanism=other.mechanism, e=other.e, memo=other.memo)
            if _differ_in_torques(s, shifted):  # all forces of the model are the same
                S = terms.tau - shifted.measured(shifted.mechanism.driven)
            else:
                r = unbalanced(s) if r is None else r
                S = r - unbalanced(shifted)
            S = S / h
            terms.A[:, :, place - before] = S
            terms.b[:] += S * value
        for place, value, name, slope in self.slopes:
            S = terms.A[:, :, place - before]
            s.add_torque(S, name, -slope[s.part])
            terms.b[:] += S * value
        for place, drive, shape in self.scales:
            S, names = terms.A[:, :, place - before], drive.joints
            signals = replace(s.signals(names), shape=shape)
            torque = drive.scale_column(signals, s.predicted(names)[0][:, 0])
            s.add_torque(S, names[0], -torque)
            terms.b[:] += S * shape[drive.scale]
        return terms

    def terms(self, part: slice | np.ndarray, *, full: bool = False) -> Terms:
        """A x = b of some samples, in the independent coordinates or, `full`, in all."""
        s = self.samples.generalised(part) if full else self.samples.reduced(part)
        terms = self.effects(s)
        gamma = [s.gamma[:, row] for row in range(s.shape[1])]
        A, b = with_bodies(self.columns, self.point, gamma, terms.A, terms.b, share_of=s.share_of)
        if not full:
            self.add_twists(A, b, [twist.columns(part) for twist in self.twists])
        return replace(terms, A=A, b=b)

    def add_twists(self, A: np.ndarray, b: np.ndarray, columns: Sequence[np.ndarray]) -> None:
        """Add the columns (n, r, m) of `twists`, one array each, to A (n, r, k), and to b (n, r)
        what they are at the working point.
        """
        for twist, S in zip(self.twists, columns, strict=True):
            A[:, :, twist.places] += S
            b += S @ twist.x


def _differ_in_torques(s: Samples, other: Samples) -> bool:
    """Return whether samples of one state differ from those of another in measured torques alone,
    with the same values of all effects.
    """
    e, o = s.e, other.e
    series = ("q", "v", "a", "y", "yd", "ydd", "still", "wrench", "loop")
    same = all(getattr(e, name) is getattr(o, name) for name in series)
    return same and s.mechanism is other.mechanism


def check_needs(mechanism: Mechanism, log: str, columns: Container[str]) -> None:
    """Refuse an effect without the other effect, or the column of the log, that it needs."""
    mechanism.check_required()
    for effect in mechanism.effects:
        # what a drive reads was asked for with the log; a motion that was made up has none
        for name in () if effect.supplies_torque else effect.reads():
            if name not in columns:
                raise MotionError(
                    f"{log}: has no column '{name}', which effect '{effect.label}' needs; log "
                    f"it, map it in [log], or leave out {effect.label}"
                )


SHORTEST_REST = 0.1  # range: s; a joint that turns round is slow for less
IMMOBILE = 1e-9  # numerics: of a joint's largest transmission: below, it does not move
PIECE = 1024  # work: rows that are put together at once, where none is made of all samples


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of n consecutive samples, d independent coordinates and k unknowns."""

    t: np.ndarray  # (n,) [s]
    sample: np.ndarray  # (n,) index into the state
    A: np.ndarray  # (n, d, k)
    b: np.ndarray  # (n, d), with all that is known moved to the right
    tau: np.ndarray  # (n, d), the measured torques Zᵀτ alone
    informed: np.ndarray  # (n, d), false where dry friction at standstill leaves the torque open
    moving: np.ndarray  # (n, d), false where a joint stands still, whether it has friction or not
    # (n, d) weight of a row at rest with open friction, so that a stretch counts as one; else 0
    rest: np.ndarray

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, which: slice | np.ndarray) -> Rows:
        """Some of the rows."""
        return Rows(**{name: x[which] for name, x in vars(self).items()})

    def scale_of(self, weight: np.ndarray | None, every: int = 1) -> np.ndarray:
        """Return (n, d) by which rows at rest are multiplied, 1 elsewhere; see `resting`."""
        if weight is None:
            return np.ones(self.rest.shape)
        scale = np.sqrt(every) * self.rest * weight
        return np.where(scale > 0, scale, 1.0)

    def resting(self, weight: np.ndarray | None, every: int = 1) -> Rows:
        """Return the rows with those at rest among those that inform, weighed by `weight` (d,) over
        one in motion; None leaves them out. These are one of `every` rows.
        """
        if weight is None or not (self.rest * weight).any():
            return self
        scale = self.scale_of(weight, every)
        A, b, tau = self.A * scale[:, :, None], self.b * scale, self.tau * scale
        return replace(self, A=A, b=b, tau=tau, informed=self.informed | (self.rest * weight > 0))

    @classmethod
    def concatenated(cls, parts: Sequence[Rows]) -> Rows:
        """Rows one after the other."""
        if len(parts) == 1:
            return parts[0]
        names = vars(parts[0])
        return cls(**{x: np.concatenate([vars(part)[x] for part in parts]) for x in names})


def informing(
    s: Samples,
    farthest: np.ndarray | None,
    informative: Sequence[tuple[str, np.ndarray]] | None = None,
    least: float = PARSIMONY,
) -> np.ndarray:
    """(n, r), false where a joint of the coordinate does not inform: by default one with dry
    friction that stands still; `farthest` is `largest_transmission`, and a joint that moves by less
    than the share `least` of it is none of the coordinate's.
    """
    informed = np.ones(s.shape, dtype=bool)
    for name, moves in s.informative if informative is None else informative:
        at, lever = s.lever(name)
        most = np.ones(1) if farthest is None else farthest[s.mechanism.joint_index[name]]
        is_moved = (most > IMMOBILE * most.max()) & (np.abs(lever) > least * most)
        informed[:, at] &= moves[:, None] | ~is_moved
    return informed


def of_joints(s: Samples, good: np.ndarray, farthest: np.ndarray | None) -> np.ndarray:
    """(n, r), false where a joint that moves with the coordinate is not `good` (n, J)."""
    joints = s.mechanism.joint_index.items()
    return informing(
        s, farthest, [(name, good[:, j]) for name, j in joints if not good[:, j].all()]
    )


def stretches_at_rest(samples: Samples, farthest: np.ndarray | None) -> np.ndarray:
    """(n, d) 1/√samples of the stretch at rest that a sample is in, 0 elsewhere.

    What friction takes up lasts as long as a stretch does, so all of it weighs as much as one row;
    of poses each is a stretch. Where a torque is exactly 0, a brake holds the joint.
    """
    e = samples.e
    if e.poses:
        return np.ones((len(e), e.leverage.shape[2]))
    s = samples.reduced(slice(None))
    opened = ~informing(s, farthest) & e.usable[:, None]
    opened &= s.measured(s.mechanism.driven) != 0
    weights = np.zeros(opened.shape)
    least = SHORTEST_REST * e.rate
    for u in range(opened.shape[1]):
        for run in runs(opened[:, u]):
            if run.stop - run.start >= least:
                weights[run, u] = 1 / np.sqrt(run.stop - run.start)
    return weights


def in_motion(s: Samples, farthest: np.ndarray | None) -> np.ndarray:
    """(n, r), false where a joint stands still that moves with the coordinate."""
    return of_joints(s, np.abs(s.e.yd[s.part]) >= s.e.still, farthest)


def largest_transmission(e: State) -> np.ndarray | None:
    """Largest transmission (J, d) of every joint over the state; None for a tree."""
    if e.loop is None:
        return None
    return np.abs(e.leverage[e.usable]).max(axis=0, initial=0.0)


@dataclass(frozen=True, eq=False)
class DataRows:
    """What filtered rows have of the log alone, whatever is unknown: N rows, d coordinates."""

    sample: np.ndarray  # (N,) index into the state
    tau: np.ndarray  # (N, d) measured torques
    informed: np.ndarray  # (N, d), as `Rows` have it; false of poses
    moving: np.ndarray  # (N, d), false where a joint stands still
    rest: np.ndarray  # (N, d), as `Rows` have it


def data_rows(
    scene: Scene,
    cutoff: float | None,
    sticking: float = STICKING,
    farthest: np.ndarray | None = None,
    keep: bool = True,
) -> DataRows:
    """Return the data of all rows of a state; arguments as of `rows`."""
    e, local = scene.e, [effect for effect in scene.mechanism.effects if effect.local]
    segments = e.segments()
    spans = tuple((run.start, run.stop) for run in segments)
    labels = tuple((type(effect), effect.label) for effect in local)  # these say which inform
    key = "data", cutoff, sticking, e.loop is not None, spans, labels
    keep = keep and farthest is None and all(_of_label(type(effect)) for effect in local)
    if keep and (stored := e.store.get(key, e.tau)) is not None:
        return DataRows(*stored)
    farthest = largest_transmission(e) if farthest is None else farthest
    at_rest = stretches_at_rest(scene.samples, farthest)
    decimator = Decimator.of(cutoff, e.rate)

    def make(part: slice) -> list[np.ndarray]:
        s = scene.samples.reduced(part)
        informed = informing(s, farthest) & (not e.poses)
        return [s.measured(s.mechanism.driven), informed, in_motion(s, farthest)]

    d = e.leverage.shape[2]
    pieces = [[np.zeros(0, int), np.zeros((0, d)), *np.zeros((2, 0, d), bool), np.zeros((0, d))]]
    for segment in segments:
        for sample, (tau, opened, standing) in decimator.filtered(segment, make):
            weights = at_rest[sample] * np.sqrt(decimator.factor)
            rest = np.where(opened > 1 - STANDING, weights, 0.0)
            pieces.append([sample, tau, opened < sticking, standing < STANDING, rest])
    every = [np.concatenate(x) for x in zip(*pieces, strict=True)]
    if keep:
        e.store.put(key, e.tau, every)
    return DataRows(*every)


def rows(
    scene: Scene,
    cutoff: float | None,
    sticking: float = STICKING,
    farthest: np.ndarray | None = None,
    keep: bool = True,
) -> Iterator[Rows]:
    """All rows of a state in pieces, filtered at `cutoff` [Hz] and decimated.

    A row informs if less than the share `sticking` of it comes from samples that do not; `farthest`
    is `largest_transmission` of the whole log. Filtered columns of Γ and of effects, which hang on
    no parameter or torque, are stored with the state, unless it is seen once (`keep`).
    """
    e, model = scene.e, scene.mechanism.model
    segments = e.segments()
    key = "Γ", cutoff, e.loop is not None, tuple((run.start, run.stop) for run in segments)
    stored = e.store.get(key, model)
    # for each independent coordinate the stretch of Γ's columns that can differ from zero
    every = [slice(0, len(scene.mechanism.prior))] * e.leverage.shape[2]
    spans = row_spans(model) if e.loop is None else every
    supports = row_supports(scene.mechanism, scene.columns, e)
    decimator, before = Decimator.of(cutoff, e.rate), len(scene.columns.rigid)
    step = smooth_step(scene, cutoff)
    smooth = smooth_places(scene.columns) if step > 1 else np.empty(0, dtype=int)
    lasting = _lasting(scene, (cutoff, *key[2:]), supports, smooth) if keep else []
    made = {effect.label for effect in lasting if effect.stored is not None}
    # by row the effects' columns that are made at all samples, and those made at nodes
    missing = np.arange(len(scene.columns)) >= before
    missing[np.concatenate([smooth, *(x.places for x in lasting if x.label in made)])] = False
    sharp = [s[missing[s]] - before for s in supports]
    thin = [np.intersect1d(s, smooth) for s in supports]
    fresh: list[list[np.ndarray]] | None = [] if stored is None and keep else None
    data, b_is_tau = data_rows(scene, cutoff, sticking, farthest, keep), _b_is_tau(scene)
    of_scene = (stored is not None or step > 1) and b_is_tau and not any(map(len, sharp))

    def make(part: slice) -> list[np.ndarray]:
        """Effects' columns by row, twists, b if it is not τ, and Γ by row, of all samples."""
        s = scene.samples.reduced(part)
        terms = scene.effects(s, step > 1, made)
        effects = [terms.A[:, u, support] for u, support in enumerate(sharp)]
        gamma = gamma_of(s) if stored is None and step == 1 else []
        twists = [twist.columns(part) for twist in scene.twists]
        return [*effects, *twists, *([] if b_is_tau else [terms.b]), *gamma]

    def made_before(segment: slice) -> Iterator[tuple[np.ndarray, list[np.ndarray]]]:
        """The samples of a run's rows, all of whose series are stored or made at nodes."""
        first, stop = np.searchsorted(data.sample, (segment.start, segment.stop))
        for start in range(first, stop, PIECE):
            sample = data.sample[start : min(start + PIECE, stop)]
            yield sample, [np.empty((len(sample), 0))] * d

    def gamma_of(s: Samples) -> list[np.ndarray]:
        return [s.gamma[:, u, span] for u, span in enumerate(spans)]

    def make_smooth(nodes: np.ndarray) -> list[np.ndarray]:
        """Smooth effects' columns by row, and Γ by row, of some samples."""
        s = scene.samples.reduced(nodes)
        A = smooth_columns(s, scene.columns, smooth)
        effects = [A[:, u, np.searchsorted(smooth, support)] for u, support in enumerate(thin)]
        return [*effects, *(gamma_of(s) if stored is None else [])]

    d, done, size, twists = len(spans), 0, 0, len(scene.twists)
    for segment in segments:
        thinning = Thinning(decimator, step, segment.stop - segment.start)
        at_nodes = NodeSeries(thinning, make_smooth, segment.start)
        pieces = made_before(segment) if of_scene else decimator.filtered(segment, make)
        for sample, series in pieces:
            now = slice(done, done + len(sample))
            smoothed = at_nodes.rows(sample) if step > 1 else []
            if stored is not None:
                gamma = [x[:, now].T for x in stored]
            else:
                gamma = smoothed[d:] if step > 1 else series[d + twists + (not b_is_tau) :]
                size += sum(x.nbytes for x in gamma)
                fresh = fresh if fresh is not None and e.store.fits(size) else None
                if fresh is not None:
                    fresh.append(gamma)
            A = np.zeros((d, len(scene.columns) - before, len(sample))).transpose(2, 0, 1)
            for u in range(d):
                A[:, u, sharp[u]] = series[u]
                if step > 1:
                    A[:, u, thin[u] - before] = smoothed[u]
            for effect in lasting:
                effect.exchange(A, before, now)
            done = now.stop
            tau, informed, rest = (x[now].copy() for x in (data.tau, data.informed, data.rest))
            b = tau.copy() if b_is_tau else series[d + twists]
            A, b = with_bodies(
                scene.columns, scene.point, gamma, A, b, spans, scene.samples.share_of
            )
            scene.add_twists(A, b, series[d : d + twists])
            for u in scene.mechanism.unmeasured_rows:
                A[:, u], b[:, u], tau[:, u], informed[:, u] = 0.0, 0.0, 0.0, False
                rest[:, u] = 0.0
            moving = data.moving[now] & informed
            yield Rows(e.t[sample], sample, A, b, tau, informed, moving, rest)
    for effect in lasting:
        if effect.stored is None and effect.pieces:
            e.store.put(effect.key, model, effect.whole)
    if fresh:
        e.store.put(
            key, model, [np.hstack([x.T for x in pieces]) for pieces in zip(*fresh, strict=True)]
        )


@dataclass(eq=False)
class LastingColumns:
    """Filtered columns of an effect that are those of the motion, whatever the parameters."""

    label: str
    key: tuple[object, ...]  # in the state's store
    places: np.ndarray  # in x
    rows: list[np.ndarray]  # by independent coordinate, which of the places it has
    stored: Sequence[np.ndarray] | None  # by coordinate (columns, N)
    pieces: list[list[np.ndarray]] = field(default_factory=list)  # of what is not stored yet

    def exchange(self, A: np.ndarray, before: int, which: slice) -> None:
        """Fill what is stored into some rows' columns (n, d, …), or keep what is there."""
        if self.stored is None:
            self.pieces.append([A[:, u, at - before].T for u, at in enumerate(self.rows)])
            return
        for u, (at, x) in enumerate(zip(self.rows, self.stored, strict=True)):
            A[:, u, at - before] = x[:, which].T

    @property
    def whole(self) -> list[np.ndarray]:
        """All pieces, one after the other."""
        return [np.hstack(pieces) for pieces in zip(*self.pieces, strict=True)]


def _lasting(
    scene: Scene, of_rows: tuple[object, ...], supports: Sequence[np.ndarray], smooth: np.ndarray
) -> list[LastingColumns]:
    """Return the columns of a scene that last, but for those at nodes, whose labels say all of
    them; `of_rows`: what says which rows these are.
    """
    e, model, k = scene.e, scene.mechanism.model, len(scene.columns)
    at_nodes, has = np.zeros(k, dtype=bool), np.zeros((len(supports), k), dtype=bool)
    at_nodes[smooth] = True
    for row, support in zip(has, supports, strict=True):
        row[support] = True
    lasting = list[LastingColumns]()
    for effect, places in scene.columns.effects:
        plain = is_plain(effect) and not effect.settings and _of_label(type(effect))
        if not plain or places.min(initial=0) < 0 or at_nodes[places].any():
            continue
        share = scene.mechanism.share_in(effect, e.name)
        key = ("effect", type(effect), effect.label, share, *of_rows)
        rows = [places[row[places]] for row in has]
        lasting.append(LastingColumns(effect.label, key, places, rows, e.store.get(key, model)))
    return lasting


@cache
def _of_label(kind: type[Effect]) -> bool:
    """Return whether effects of a class with the same label are the same, but for values."""
    return [entry.name for entry in fields(kind)] == [entry.name for entry in fields(Effect)]


def _b_is_tau(scene: Scene) -> bool:
    """Return whether the known side of the rows of effects is that of the log's torques alone."""
    corrections = scene.perturbed or scene.slopes or scene.scales or scene.twists
    torques = [(x, at) for x, at in scene.columns.effects if not (x.corrects or x.loaded_link)]
    known = any(x.shapes or at.min(initial=0) < 0 for x, at in torques)
    return not (corrections or known) and scene.e.wrench is None


def smooth_step(scene: Scene, cutoff: float | None) -> int:
    """Return the distance of the samples at which Γ and smooth columns of a state are made, so
    that filtered rows are those of all samples to within a share of the torques' noise.
    """
    e, model = scene.e, scene.mechanism.model
    decimator, key = Decimator.of(cutoff, e.rate), ("step", cutoff)
    if decimator.taps is None or cutoff is None or decimator.factor == 1:
        return 1
    if (stored := e.store.get(key, model)) is not None:
        return int(stored[0][0])
    noise = np.array([e.noise.get(f"tau.{name}", 0.0) for name in scene.mechanism.driven])
    torque = np.sqrt((e.tau[e.usable] ** 2).mean(axis=0)) if e.usable.any() else np.ones(1)
    passed = float(np.sqrt(decimator.taps @ decimator.taps))
    share = float((passed * noise[torque > 0] / torque[torque > 0]).min(initial=1.0))
    tolerance = float(np.clip(OF_NOISE * share, EXACT, LOOSEST))
    speed, rise = np.abs(e.v).max(initial=1e-300), np.abs(e.a).max(initial=1e-300)

    def quick(part: slice | np.ndarray) -> np.ndarray:
        v = e.v[part] / speed
        return np.hstack([v, v * v, e.a[part] / rise])

    def all_rows(part: slice | np.ndarray) -> np.ndarray:
        return scene.samples.reduced(part).gamma.reshape(len(e.t[part]), -1)

    step = agreeing_step(decimator, e.rate, cutoff, e.segments(), quick, all_rows, tolerance)
    e.store.put(key, model, [np.array([step])], always=True)
    e.store.put(NODES, model, [np.array([step, tolerance])], always=True)
    return step


def row_supports(mechanism: Mechanism, columns: Columns, e: State) -> list[np.ndarray]:
    """For each independent coordinate the unknowns that can appear in its rows."""
    k, d = len(columns), e.leverage.shape[2]
    constant = e.loop is None or e.pinv.strides[0] == 0
    # a load twists its spring, and that moves all bodies behind it; a loop's transmission may be
    # zero at some samples alone
    if not constant or any(effect.by_load for effect in mechanism.effects):
        return [np.arange(k)] * d
    index, bodies, supports_of_rows = mechanism.joint_index, supports(mechanism.model), []
    # which coordinates move which of the model's joints, and which of the mechanism's
    if e.loop is None:
        of_model = np.eye(len(bodies), dtype=bool)
        of_mechanism = of_model[[joint.index for joint in mechanism.joints]]
    else:
        of_model, of_mechanism = (x.astype(bool) for x in (e.pinv[0, :, -d:], e.leverage[0]))
    of_effects = [
        (of_mechanism[[index[name] for name in effect.joints if name in index]], effect.local, at)
        for effect, at in columns.effects
    ]
    for u in range(d):
        reached = np.concatenate([bodies[j] for j in np.flatnonzero(of_model[:, u])])
        support = [np.flatnonzero(np.isin(columns.rigid, reached))]
        support += [at[at >= 0] for acts, local, at in of_effects if not local or acts[:, u].any()]
        supports_of_rows.append(np.concatenate(support).astype(int))
    return supports_of_rows


ABSENT = 1e-9  # numerics: of a unit torque: below, it is not in a row


def stack(scene: Scene, cutoff: float | None, segment: slice, basis: Basis) -> Iterator[Chunk]:
    """The stack of one run of usable samples, in pieces, filtered like all columns."""
    e = scene.e
    decimator = Decimator.of(cutoff, e.rate)
    pieces = decimator.filtered(segment, lambda part: full_rows(scene, part))
    for sample, (A, b, opened) in pieces:
        informed = opened < STICKING
        inside = slice(sample[0] - decimator.half, sample[-1] + decimator.half + 1)
        J_T = scene.mechanism.kinematics.closure_rows(e.q[inside]).rate.transpose(0, 2, 1)
        first, values = basis.window(e.t[inside])
        values = values[:, :, None, None] * J_T[:, None]  # L = Jᵀ B(t) (paper, eq. 7)
        first, L = filtered_windows(
            decimator, basis, e.t[inside], first, values, sample - inside.start
        )
        first = np.broadcast_to(first[:, None], b.shape)
        yield Chunk(first[informed], L.transpose(0, 2, 1, 3)[informed], A[informed], b[informed])


def full_rows(scene: Scene, part: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (n, nv, k), b (n, nv) of [Γ E] and the known side, and (n, nv) whether a row informs."""
    s, terms = scene.samples.generalised(part), scene.terms(part, full=True)
    return terms.A, terms.b, informing(s, None, least=ABSENT)
