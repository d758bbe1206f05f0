"""The state of a mechanism over one log: motion of all coordinates, forces applied to it.

`State.at` is the only way to another state: it completes all coordinates from those of some joints,
and gives K⁺ = [J; W_u]⁺ and the velocity transmission ∂ẏ/∂u̇ that belong to them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin

from ident.errors import MotionError, one_of
from ident.information import linear
from ident.mechanism.mechanism import Mechanism
from ident.motion.closures import LoopSolver
from ident.motion.signals import runs
from ident.motion.spline import Smooth, Smoothed

SINGULAR = 50.0  # tuned: times the log's median ‖K⁺‖: beyond, a sample is near a singular position
HOPELESS = 1e6  # numerics: ‖K⁺‖ at which a position is singular whatever the median is
LEFT_OPEN = 1e-6  # numerics: [m | rad] largest equation of a sample, used at other coordinates


class Store:
    """A cache of a state's slow arrays; those of all states stay below `LIMIT` bytes, but for up to
    `OF_STATE` bytes of a state by which others are made in another way: no result depends on how
    much room others leave.
    """

    LIMIT: ClassVar[int] = 128_000_000
    OF_STATE: ClassVar[int] = 64_000_000  # work: bytes that are kept whatever other states keep
    STATES: ClassVar[int] = 2  # work: that are kept: at a point, and a step of one shape from it
    _used: ClassVar[int] = 0

    def __init__(self) -> None:
        self._arrays: dict[object, tuple[object, Sequence[np.ndarray]]] = {}
        self._states: dict[object, tuple[object, State]] = {}
        self._always = 0  # bytes that are kept in any case

    def get(self, key: object, owner: object) -> Any:
        """The entry of a key and this very owner; None if there is none."""
        of, value = self._arrays.get(key, (None, None))
        return value if of is owner else None

    def put(
        self, key: object, owner: object, value: Sequence[np.ndarray], always: bool = False
    ) -> None:
        """Keep arrays, if there is room, or `always`."""
        size = sum(x.nbytes for x in value)
        if (always or self.fits(size)) and key not in self._arrays:
            Store._used += size
            self._always += always * size
            self._arrays[key] = owner, value

    def fits_always(self, size: int) -> bool:
        """Whether so many bytes more can be kept in any case."""
        return self._always + size <= self.OF_STATE

    def state(self, key: object, owner: object) -> State | None:
        """Return the state that was made from this one by a key, of this very owner, or None."""
        of, state = self._states.get(key, (None, None))
        return state if of is owner else None

    def put_state(self, key: object, owner: object, state: State) -> None:
        """Keep a state with what is stored of it, for the last one that was kept."""
        while key in self._states or len(self._states) >= self.STATES:
            _, last = self._states.pop(key if key in self._states else next(iter(self._states)))
            Store._used -= last.nbytes
        if self.fits(state.nbytes):
            Store._used += state.nbytes
            self._states[key] = owner, state

    @classmethod
    def fits(cls, size: int) -> bool:
        """Whether so many bytes more can be kept."""
        return cls._used + size <= cls.LIMIT

    def __del__(self) -> None:
        Store._used -= sum(x.nbytes for _, value in self._arrays.values() for x in value)
        Store._used -= sum(state.nbytes for _, state in self._states.values())

    def __reduce__(self) -> tuple[type[Store], tuple[()]]:
        return Store, ()  # a copy in another process starts empty


_none = partial(np.empty, 0)


@dataclass(frozen=True, eq=False)
class State:
    """One log's motion on a uniform clock: n samples, J joints, d independent coordinates."""

    name: str  # the log's
    t: np.ndarray  # (n,) [s], uniform
    tau: np.ndarray  # (n, driven) measured torques, in the order of `mechanism.driven`
    usable: np.ndarray  # (n,), false where a sample takes no part; `Motion.notes` say why
    q: np.ndarray = field(default_factory=_none)  # q, v, a: (n, nq), (n, nv), (n, nv), the model's
    v: np.ndarray = field(default_factory=_none)
    a: np.ndarray = field(default_factory=_none)
    y: np.ndarray = field(default_factory=_none)  # y, yd, ydd: (n, J) of the mechanism's joints
    yd: np.ndarray = field(default_factory=_none)
    ydd: np.ndarray = field(default_factory=_none)
    wrench: np.ndarray | None = None  # (n, nv) generalised forces of measured external wrenches
    still: np.ndarray = field(default_factory=_none)  # (J,) speed of standstill [rad/s | m/s]
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)  # the log's other columns
    logged: tuple[str, ...] = ()  # joints from whose coordinates the motion was completed
    independent: tuple[str, ...] = ()  # joints to which `leverage` refers
    noise: Mapping[str, float] = field(default_factory=dict)  # white, of channels, by column
    smooth: Smooth | None = None  # splines behind the motion; None: the log was taken as it is
    channels: tuple[Smoothed, ...] = ()  # how each channel of the motion was smoothed
    ends: float = 0.0  # time [s] at the ends of a run where splines are not to be trusted
    poses: bool = False  # whether samples are poses at rest, without order; t is their number
    # (d,) weight of a row at rest over that of one in motion; None before it is known
    rest: np.ndarray | None = None
    loop: tuple[np.ndarray, np.ndarray] | None = None  # `pinv`, `leverage`; None for a tree
    store: Store = field(default_factory=Store, init=False)  # of what is slow to make from these

    def __len__(self) -> int:
        return len(self.t)

    @property
    def nbytes(self) -> int:
        """Bytes of the motion's arrays; of one sample's where all are the same."""
        series = (self.q, self.v, self.a, self.y, self.yd, self.ydd, *(self.loop or ()))
        whole = {id(x): x.nbytes if len(x) and x.strides[0] else x[:1].nbytes for x in series}
        return sum(whole.values())

    @property
    def pinv(self) -> np.ndarray:
        """K⁺ (n, nv, m + d), the pseudo-inverse of [J; W_u]."""
        return self._identity if self.loop is None else self.loop[0]

    @property
    def leverage(self) -> np.ndarray:
        """Velocity transmission (n, J, d): ẏ_j for unit rate of each independent coordinate."""
        return self._identity if self.loop is None else self.loop[1]

    @property
    def _identity(self) -> np.ndarray:
        n, nv = self.v.shape
        return np.broadcast_to(np.eye(nv), (n, nv, nv))  # takes no memory

    @property
    def rate(self) -> float:
        """Samples a second [Hz]; 0 of poses, which have no time."""
        return 0.0 if self.poses else (len(self.t) - 1) / float(self.t[-1] - self.t[0])

    def drive_torques(self, needed: np.ndarray, drives: Sequence[int]) -> np.ndarray:
        """Torques (n, driven) of joints that make `needed` (n, d); surplus drives share them."""
        if self.loop is None:
            return needed[:, drives]
        L = self.leverage[:, drives]
        return np.einsum("ndj,nd->nj", linear.pinv(L, rcond=1e-6), needed)

    def thinned(self, every: int) -> State:
        """One sample of `every`, for what is smooth."""
        return self if every == 1 else self.at_samples(slice(None, None, every))

    def at_samples(self, index: slice | np.ndarray) -> State:
        """Some samples only."""
        arrays = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        series = {
            name: x
            for name, x in arrays.items()
            if name not in ("still", "rest")
            and isinstance(x, np.ndarray)
            and len(x) == len(self)  # completed
        }
        distinct = {id(x): x[index] for x in series.values()}  # q is y, in a tree
        cut: dict[str, Any] = {name: distinct[id(x)] for name, x in series.items()}
        cut["extra"] = {name: x[index] for name, x in self.extra.items()}
        loop = None if self.loop is None else (self.loop[0][index], self.loop[1][index])
        return replace(self, **cut, loop=loop)

    def with_rest(self, weight: np.ndarray | None) -> State:
        """The same state, a row at rest with a weight (d,) over that of one in motion."""
        return self._same_motion(replace(self, rest=weight))

    def with_torques(self, tau: np.ndarray, usable: np.ndarray | None = None) -> State:
        """The same motion with other torques (n, driven), by default usable where it was."""
        usable = self.usable if usable is None else usable
        return self._same_motion(replace(self, tau=tau, usable=usable))

    def _same_motion(self, e: State) -> State:
        """Return a state, with what is stored of this one: nothing of it hangs on torques, weights
        or which samples are usable.
        """
        object.__setattr__(e, "store", self.store)
        return e

    def segments(self) -> list[slice]:
        """Runs of usable samples; nothing is filtered or differentiated across their ends."""
        return runs(self.usable)

    def known(self, mechanism: Mechanism, names: Sequence[str] = ()) -> np.ndarray:
        """Coordinates, rates, accelerations (3, n, d) of some joints, by default the logged."""
        at = [mechanism.joint_index[name] for name in names or self.logged]
        return np.stack([y[:, at] for y in (self.y, self.yd, self.ydd)])

    def at(
        self,
        mechanism: Mechanism,
        known: np.ndarray | None = None,
        names: tuple[str, ...] = (),
        *,
        motion: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
        start: str = "near",
    ) -> State:
        """The mechanism in another state, with all that follows from it.

        Where links swing behind their motors, `known` is of the motors, and the links stay as far
        from them as they are. K⁺ and the transmission are those of the new state if this one has
        them; samples that are near a singular position, or at which the closures stay open, are
        not usable.

        Args:
            mechanism: that moves; it may have other lengths than before.
            known: (3, n, d) coordinates, rates and accelerations of joints that determine the
                motion; names: these joints, by default the logged ones.
            motion: q, v, a of the model in place of these; closures' own joints stay within half a
                turn of where they are.
            start: of the search for q: `near` its present value; `follow` the motion from the
                assembled configuration; `same`, q is not moved.

        Raises:
            MotionError: if the closures cannot follow, or every sample is near a singular position.
        """
        usable, turns, inverse = self.usable, dict[str, np.ndarray](), None
        motors, swing = known, None
        if known is not None:
            names = names or self.logged
            swing = self._swing(mechanism, names)
            known = known + swing if swing.any() else known
        if known is None:
            turns = {joint.name: self.y[:, i] for i, joint in enumerate(mechanism.joints)}
        else:
            turns = dict(zip(names, known[0].T, strict=True))
            if not mechanism.closures:
                order = np.argsort([mechanism.joint(name).index for name in names])
                q, v, a = (np.ascontiguousarray(x[:, order]) for x in known)
            else:
                solver = LoopSolver(mechanism, names, np.maximum(known[0].std(axis=0), 1e-9))
                q, again = self.q, self.loop is not None and names == self.independent
                if start == "follow":
                    order = tour(known[0]) if self.poses else np.arange(len(self))
                    q = np.empty((len(self), mechanism.model.nq))
                    q[order] = solver.follow(known[0][order], self.t)
                elif start == "near":
                    chord = again and not solver.surplus
                    near = solver.near(q, self.pinv, known[0]) if chord else None
                    q, gap = solver.newton(q, known[0]) if near is None else near
                    usable = usable & (gap < LEFT_OPEN)
                v, a, inverse = solver.completed(q, *known[1:])
                inverse = inverse if again and not solver.surplus else None
            motion = q, v, a
        assert motion is not None
        y, yd, ydd = joint_coordinates(mechanism, *motion, turns)
        q, v, a = motion
        if motors is not None and swing is not None and swing.any():
            swings = np.flatnonzero(swing.any(axis=(0, 1)))
            columns = [mechanism.joint_index[names[i]] for i in swings]
            y, yd, ydd = y.copy(), yd.copy(), ydd.copy()
            for series, of_motors in zip((y, yd, ydd), motors, strict=True):
                series[:, columns] = of_motors[:, swings]
        e = replace(self, q=q, v=v, a=a, y=y, yd=yd, ydd=ydd, usable=usable)
        if self.loop is None or start == "same":
            return e
        return e.transmitted(mechanism, self.independent, inverse=inverse)

    def stepped(self, mechanism: Mechanism, steps: Mapping[str, np.ndarray]) -> State:
        """The same with logged joints elsewhere, by (3, n) of their coordinates and two rates; a
        tree keeps what no step changes.
        """
        in_place = self.q is self.y and self.v is self.yd and self.a is self.ydd
        if mechanism.closures or not in_place:
            known = self.known(mechanism)
            for name, step in steps.items():
                known[:, :, self.logged.index(name)] += step
            return self.at(mechanism, known)
        motion = [self.q, self.v, self.a]
        for order in range(3):
            moved = [name for name, step in steps.items() if step[order].any()]
            motion[order] = motion[order].copy() if moved else motion[order]
            for name in moved:
                motion[order][:, mechanism.joint_index[name]] += steps[name][order]
        q, v, a = motion
        return replace(self, q=q, v=v, a=a, y=q, yd=v, ydd=a)

    def _swing(self, mechanism: Mechanism, names: Sequence[str]) -> np.ndarray:
        """Return q, v and a (3, n, d) of joints' links less those of their motors, which are y."""
        swing = np.zeros((3, len(self), len(names)))
        if not self.q.shape[:1] == self.y.shape[:1] == (len(self),):  # not completed yet
            return swing
        if self.q is self.y and self.v is self.yd and self.a is self.ydd:
            return swing
        for i, joint in enumerate(mechanism.joint(name) for name in names):
            if joint.in_tree:
                u = mechanism.joint_index[joint.name]
                both = (self.q, self.y), (self.v, self.yd), (self.a, self.ydd)
                swing[:, :, i] = [x[:, joint.index] - y[:, u] for x, y in both]
        return swing

    def transmitted(
        self,
        mechanism: Mechanism,
        independent: tuple[str, ...],
        largest: float | None = None,
        inverse: np.ndarray | None = None,
    ) -> State:
        """With K⁺ and velocity transmission in the independent coordinates.

        Args:
            mechanism: a tree has neither; independent: joints to which they refer.
            largest: ‖K⁺‖ from which on a sample is near a singular position and not usable;
                default: of this state.
            inverse: K⁺ where it is known already.

        Raises:
            MotionError: if every sample is near a singular position.
        """
        if not mechanism.closures:
            return self
        joints, m = mechanism.joints, len(mechanism.kinematics.multipliers)
        every = None
        if not all(joint.in_tree for joint in joints):
            every = LoopSolver(mechanism, (j.name for j in joints)).coordinates(self.q).rate
        if inverse is None:
            J = mechanism.kinematics.closure_rates(self.q)
            inverse = LoopSolver(mechanism, independent).inverse(self.q, J)
        Kp, Z = inverse, inverse[:, :, m:]
        same = inverse.strides[0] == 0 and every is None  # in the memory of one sample
        if every is None:
            leverage = Z[: 1 if same else None, [joint.index for joint in joints]]
        else:
            leverage = every @ Z
        if same:
            leverage = np.broadcast_to(leverage, (len(self), *leverage.shape[1:]))
        e = replace(self, loop=(Kp, leverage), independent=independent)
        size = nearness(e)
        limit = largest_nearness(size) if largest is None else largest
        usable = self.usable if limit == np.inf else self.usable & (size < limit)
        if largest is None and not usable.any():
            raise MotionError(
                f"{self.name}: every sample is near a singular position of {mechanism.name}; "
                "nothing can be identified from it"
            )
        return replace(e, usable=usable)


def tour(y: np.ndarray) -> np.ndarray:
    """Return an order of poses y (n, d) in which each is the nearest of the rest (greedy)."""
    rest, order = [*range(1, len(y))], [0]
    while rest:
        near = int(np.linalg.norm(y[rest] - y[order[-1]], axis=1).argmin())
        order.append(rest.pop(near))
    return np.array(order)


def nearness(e: State) -> np.ndarray:
    """‖K⁺‖ (n,) of every sample: it grows towards a singular position."""
    one = len(e) > 0 and e.pinv.strides[0] == 0  # of all samples the same
    sizes = np.linalg.norm(e.pinv[:1] if one else e.pinv, axis=(1, 2))
    return np.broadcast_to(sizes, len(e)) if one else np.asarray(sizes)


def largest_nearness(sizes: np.ndarray) -> float:
    """‖K⁺‖ from which on a position counts as singular, in a motion with these (n,)."""
    return min(HOPELESS, SINGULAR * float(np.median(sizes)))


def joint_coordinates(
    mechanism: Mechanism,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    turns: Mapping[str, np.ndarray],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """y, ẏ, ÿ (n, J) of all joints, with the whole turns of `turns`."""
    if all(joint.in_tree for joint in mechanism.joints):
        order = [joint.index for joint in mechanism.joints]
        if order == list(range(q.shape[1])):  # the same arrays: no second copy of long logs
            return q, v, a
        return q[:, order], v[:, order], a[:, order]
    rows = LoopSolver(mechanism, (j.name for j in mechanism.joints)).coordinates(q, v)
    for joint, y in zip(mechanism.joints, rows.value.T, strict=True):
        if joint.rotational and not joint.in_tree:
            y[:] = np.unwrap(y)
            if joint.name in turns:
                y -= 2 * np.pi * np.round((y - turns[joint.name]) / (2 * np.pi))
    rates = np.einsum("njk,nk->nj", rows.rate, v)
    return rows.value, rates, np.einsum("njk,nk->nj", rows.rate, a) + rows.drift


def wrenches(
    mechanism: Mechanism, name: str, columns: Mapping[str, np.ndarray], q: np.ndarray
) -> np.ndarray | None:
    """Generalised forces (n, nv) of columns `wrench.<link>.<fx…mz>`, in the link's frame."""
    parts = ("fx", "fy", "fz", "mx", "my", "mz")
    known = [f.name for f in mechanism.model.frames if f.type == pin.FrameType.BODY]
    frames: dict[str, np.ndarray] = {}
    for column in (
        name_of_column for name_of_column in columns if name_of_column.startswith("wrench.")
    ):
        frame, _, part = column[len("wrench.") :].rpartition(".")
        if part not in parts or not frame:
            raise MotionError(f"{name}: column '{column}': write wrench.<link>.<{'|'.join(parts)}>")
        if frame not in known:
            raise MotionError(
                f"{name}: column '{column}': no link '{frame}'; {one_of(frame, known)}"
            )
        frames.setdefault(frame, np.zeros((len(q), 6)))[:, parts.index(part)] = columns[column]
    if not frames:
        return None
    model, data = mechanism.model, mechanism.model.createData()
    total = np.zeros((len(q), model.nv))
    for frame, wrench in frames.items():
        index = model.getFrameId(frame, pin.FrameType.BODY)
        for k in range(len(q)):
            J = pin.computeFrameJacobian(model, data, q[k], index, pin.LOCAL)
            total[k] += J.T @ wrench[k]
    return total
