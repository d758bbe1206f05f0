"""A moving mechanism: a block of reports, and a page of its own beside charts of a fit.

M a + … + Jᵀ λ = τ,  J = ∂Φ/∂q,  so a closure's reaction does the virtual work −λᵀ δΦ
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
from markupsafe import Markup

from ident.display import renders
from ident.errors import IdentError, MechanismError
from ident.files import write_all
from ident.fit.residual import zero_of
from ident.mechanism import Mechanism
from ident.mechanism.closures import FrameClosure, Placement
from ident.show.bodies import ENDS, UNKNOWN, Shape, poses_of, shapes_of, sites, tied
from ident.show.charts import Arrays, script_json
from ident.show.html import Block, piece, report_page
from ident.show.local import Place

MOST_PICTURES = 1000  # pictures of all films
WIDTH = 0.1  # [s] over which a residual is averaged, so that colours do not flicker
CLOSED = 1e-7  # [m | rad] |Φ| of a closure that nobody would call open
SHOWN = 6  # closures and notes that are listed
HEIGHT = 480  # of a notebook's frame [px]
SUFFIXES = (".html", ".htm")
FRAME_RATE = 30.0  # shown: pictures a second of a stretch with ghosts
GHOSTS = {"before": (217, 115, 13), "now": (42, 157, 92)}  # shown: as lines of charts
# shown: perceptually uniform, legible in grey and to the colour-blind: Matplotlib's `plasma`, which
# takes half a second to import
MAP = [
    "0d0887",
    "310597",
    "4c02a1",
    "6600a7",
    "7e03a8",
    "9511a1",
    "aa2395",
    "bc3587",
    "cc4778",
    "da5a6a",
    "e66c5c",
    "f0804e",
    "f89540",
    "fdac33",
    "fdc527",
    "f8df25",
    "f0f921",
]
SHADES = len(MAP)
COLD = 1e-3  # share of the residual below which no joint is to glow
ROBUST = 99.0  # percentile of residuals that gets the last colour
LONGEST = 0.4  # of the mechanism's size, for the largest reaction
ANGLE = np.radians(35.0)  # vertical angle of view
MARGIN = 1.05  # room around
LOOKED_AT = 40  # moments of a film that decide what the camera sees
WAYS = 64  # numerics: directions in which what it sees is bounded
ASPECT = 1.5  # shown: width over height of the picture in whose middle the machine is
CENTRED = 5  # work: steps to that middle
FLAT = 0.35  # thickness over width below which a mechanism is looked at face on


@dataclass(frozen=True, eq=False)
class Film:
    """A mechanism at n moments of one experiment.

    Attributes:
        name, t, q: of the experiment, (n,) [s] and (n, nq).
        gap: (n,) largest |Φ| [m | rad].
        at, force: points of action [m] and reaction forces [N] in world axes (n, K, 3), of each
            closure that ties two frames first on a, then on b; NaN where λ is not known.
        misfit: (n,) residual of each joint as a share of its rms torque, by name.
        ghosts: (n, nq) where the machine would be by the models `before` and `now`; NaN where that
            is not drawn.
    """

    name: str
    t: np.ndarray
    q: np.ndarray
    gap: np.ndarray
    at: np.ndarray
    force: np.ndarray
    misfit: Mapping[str, np.ndarray] = field(default_factory=dict)
    ghosts: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.t)


@dataclass(frozen=True, eq=False)
class Ghosts:
    """Where models would take the machine over a stretch of one experiment.

    Attributes:
        samples: of the experiment, a slice of k.
        positions: of the models before and now, (k, nq) each.
        window: [s] from one restart at the measured position to the next.
        names: of the models, as the picture calls them.
    """

    samples: slice
    positions: Sequence[np.ndarray]
    window: float
    names: Sequence[str] = tuple(GHOSTS)


def outermost(points: np.ndarray) -> np.ndarray:
    """Return those of some points (n, 3) that are farthest in one of many directions."""
    n = np.arange(WAYS) + 0.5
    z, turn = 1 - 2 * n / WAYS, np.pi * (1 + np.sqrt(5.0)) * n  # a spiral over the sphere
    ways = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    axes = np.concatenate([np.eye(3), -np.eye(3)], axis=1)
    chosen = (points @ np.concatenate([axes, ways], axis=1)).argmax(axis=0)
    return np.array(points[np.unique(chosen)])


def distance_of(outline: np.ndarray, aspect: float) -> float:
    """Return from how far [m] a pinhole camera sees all points (k, 3), in a picture `aspect` as
    wide as high; `drawScene` does the same with the picture that it has.
    """
    half = np.maximum(np.abs(outline[:, 1]), np.abs(outline[:, 0]) / aspect)
    return float((outline[:, 2] + half / np.tan(ANGLE / 2)).max())


def film_of(
    mechanism: Mechanism, experiment: Any, prediction: Any, most: int, ghosts: Ghosts | None = None
) -> Film:
    """Return at most `most` moments of an experiment, with `name`, `t` [s] and `q` (n, nq); of a
    stretch with ghosts as many as are seen as motion.
    """
    t, p = experiment.t, prediction
    moments = frames(t, most)
    drawn = dict[str, np.ndarray]()
    if ghosts is not None:
        inside = np.arange(len(t))[ghosts.samples]
        shown = frames(
            t[inside], min(most, max(most // 3, round(FRAME_RATE * float(np.ptp(t[inside])))))
        )
        moments = np.union1d(frames(t, most // 2), inside[shown])
        at = moments - inside[0]
        inside_stretch = (at >= 0) & (at < len(inside))
        for name, positions in zip(ghosts.names, ghosts.positions, strict=True):
            drawn[name] = np.full((len(moments), positions.shape[1]), np.nan)
            drawn[name][inside_stretch] = positions[at[inside_stretch]]
    q = np.asarray(experiment.q, float)[moments]
    rows = mechanism.kinematics.closure_rows(q)
    unknown = np.full((len(q), rows.rate.shape[1]), np.nan)
    points, force = reactions(mechanism, q, unknown if p is None else p.multipliers[moments])
    gap = np.abs(rows.value).max(axis=1, initial=0.0)
    film = Film(experiment.name, t[moments], q, gap, points, force, ghosts=drawn)
    if p is None:
        return film
    residual = np.where(p.usable[:, None], p.residual, np.nan)
    rms = np.sqrt(np.nanmean(p.measured**2, axis=0))
    misfit = {
        joint: running_rms(t, x / size, WIDTH, moments)
        for joint, x, size in zip(p.joints, residual.T, rms, strict=True)
        if size > 0
    }
    return replace(film, misfit=misfit)


def reactions(
    mechanism: Mechanism, q: np.ndarray, multipliers: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, K, 3) [m] and reaction forces (n, K, 3) [N] of closures of two frames, at
    configurations q (n, nq) with multipliers λ (n, m).
    """
    n, (R, p) = len(q), poses_of(mechanism.model, q)
    at: list[np.ndarray] = []
    forces: list[np.ndarray] = []
    names = [name.rpartition(".")[0] for name in mechanism.kinematics.multipliers]
    for closure in tied(mechanism):
        rows = [i for i, name in enumerate(names) if name == closure.name]
        turned, ends = [], []
        for frame in closure.frames:
            rotation, place = R[:, frame.joint], frame.placement
            turned.append((rotation @ place.rotation).transpose(1, 0, 2).reshape(3, 3 * n))
            ends.append(p[:, frame.joint] + rotation @ place.translation)
        both = _reaction(closure).map(n)(*turned, *(x.T for x in ends), multipliers[:, rows].T)
        forces += [x.full().T for x in both]
        at += [ends[1], ends[1]] if closure.sliding else ends  # of a slide both act at b
    nothing = np.zeros((n, 0, 3))
    return (np.stack(at, axis=1), np.stack(forces, axis=1)) if at else (nothing, nothing)


def _reaction(closure: FrameClosure) -> ca.Function:
    """(R_a, R_b, p_a, p_b, λ) → forces on a and on b in world axes, F = −(∂Φ/∂p)ᵀ λ."""
    Ra, Rb = ca.SX.sym("Ra", 3, 3), ca.SX.sym("Rb", 3, 3)
    pa, pb = ca.SX.sym("pa", 3), ca.SX.sym("pb", 3)
    phi = closure.between(Placement(Ra, pa), Placement(Rb, pb)).phi
    multipliers = ca.SX.sym("lambda", phi.numel())
    forces = [-ca.jtimes(phi, point, multipliers, True) for point in (pa, pb)]
    return ca.Function("reaction", [Ra, Rb, pa, pb, multipliers], forces)


def frames(t: np.ndarray, most: int) -> np.ndarray:
    """Return the indices of at most some samples of t (n,) [s], evenly in time, with both ends."""
    if len(t) <= most:
        return np.arange(len(t))
    return np.unique(np.searchsorted(t, np.linspace(t[0], t[-1], most)))


def running_rms(
    t: np.ndarray, x: np.ndarray, width: float, at: slice | np.ndarray = slice(None)
) -> np.ndarray:
    """Return the rms of x (n,) over `width` [s] around each t (n,), or around some of these, `at`;
    NaN counts as no sample.
    """
    known = np.isfinite(x)
    power = np.concatenate([[0.0], np.cumsum(np.where(known, x, 0.0) ** 2)])
    count = np.concatenate([[0], np.cumsum(known)])
    first = np.searchsorted(t, t[at] - width / 2, side="left")
    last = np.searchsorted(t, t[at] + width / 2, side="right")
    number = count[last] - count[first]
    mean = (power[last] - power[first]) / np.where(number > 0, number, np.nan)
    return np.sqrt(np.maximum(mean, 0.0))


@dataclass(frozen=True, eq=False)
class View:
    """A mechanism moving in 3-D; in a notebook a page, which needs no server and stays in the file.

    Attributes:
        mechanism, shapes, size: what is shown, and the diagonal [m] of all of it.
        films: its motion, one an experiment.
        notes: what is shown otherwise than the files have it, or not at all.
        marks: words beside joints, by their names.
        charts: below the mechanism on its page, with a cursor that both share.
        window: [s] after which ghosts begin anew at the measured position; 0 without ghosts.
        stretch: number of the film, first and last time [s] of what is played by itself.
    """

    mechanism: Mechanism
    shapes: Sequence[Shape]
    size: float
    films: tuple[Film, ...]
    notes: tuple[str, ...] = ()
    marks: Mapping[str, str] = field(default_factory=dict)
    charts: tuple[Block, ...] = ()
    window: float = 0.0
    stretch: tuple[int, float, float] | None = None

    @property
    def words(self) -> str:
        """Text alternative, for readers who cannot see it."""
        moving = " moving; move over a chart of time, or the slider, and it follows"
        return f"{self.mechanism.name} in 3-D{moving if self.moments > 1 else ''}"

    @property
    def moments(self) -> int:
        """Number of moments in a recording."""
        return sum(map(len, self.films))

    @cached_property
    def largest_force(self) -> float:
        """Largest reaction [N], drawn `LONGEST` of the size; 0 where none is known."""
        lengths = (np.linalg.norm(film.force, axis=-1) for film in self.films)
        return max(float(np.nan_to_num(x).max(initial=0.0)) for x in lengths)

    @cached_property
    def largest_misfit(self) -> float:
        """Share of the torque that gets the last colour; 0 where no residual is known."""
        shares = [x[np.isfinite(x)] for film in self.films for x in film.misfit.values()]
        every = np.concatenate([*shares, np.empty(0)])
        return max(float(np.percentile(every, ROBUST)), COLD) if len(every) else 0.0

    @property
    def legend(self) -> Markup:
        """What colours and lengths mean."""
        gap = max(float(film.gap.max(initial=0.0)) for film in self.films)
        ties = [f"{c.name}: a on {c.a.link}, b on {c.b.link}" for c in tied(self.mechanism)]
        return piece(
            "scene_legend", self, WIDTH, [_css(c) for c in _ramp()], [_css(c) for c in ENDS],
            "closed" if gap < CLOSED else f"open by up to {gap:.2g}",
            _first(ties), _first(self.notes),
        )  # fmt: skip

    @cached_property
    def camera(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Direction to a camera that sees all films, a flat mechanism face on, its target [m] and
        direction upwards (3,), and the outermost points (k, 3) of what it sees from the target [m]:
        to the right, upwards and towards the camera.
        """
        g = np.array(self.mechanism.model.gravity.linear)
        up = -g / np.linalg.norm(g) if g.any() else np.array([0.0, 0.0, 1.0])
        points = [*((x.joint, x.corners) for x in self.shapes), *enumerate(sites(self.mechanism))]
        clouds = []
        for number, film in enumerate(self.films):
            moments = np.arange(len(film))
            if self.stretch is not None:  # what is played by itself is seen from near
                inside = (film.t >= self.stretch[1]) & (film.t <= self.stretch[2])
                moments = np.flatnonzero(inside & (number == self.stretch[0]))
            if not len(moments):
                continue
            looked_at = moments[np.unique(np.linspace(0, len(moments) - 1, LOOKED_AT).astype(int))]
            R, origin = poses_of(self.mechanism.model, film.q[looked_at])
            clouds += [
                (x @ R[:, i].transpose(0, 2, 1) + origin[:, None, i]).reshape(-1, 3)
                for i, x in points
            ]
            tips = self._tips(film)[looked_at].reshape(-1, 3)
            clouds.append(tips[np.isfinite(tips).all(axis=1)])
        cloud = np.concatenate(clouds)
        target = (cloud.min(axis=0) + cloud.max(axis=0)) / 2
        spread, axes = np.linalg.eigh(np.cov((cloud - target).T) + 1e-12 * np.eye(3))
        side = np.cross(up, [0.0, 1.0, 0.0] if abs(up[1]) < 0.9 else [1.0, 0.0, 0.0])
        direction = 0.8 * side - np.cross(side, up) + 0.55 * up
        thin = axes[:, 0] * np.sign(axes[:, 0] @ direction or 1.0)
        if np.sqrt(spread[0] / spread[1]) < FLAT and thin @ up < 0.7:  # "up" stays visible
            direction = thin + 0.35 * up + 0.3 * side
        direction = direction / np.linalg.norm(direction)
        right = np.cross(up, direction)
        right /= np.linalg.norm(right)
        above = np.cross(direction, right)
        frame = np.stack([right, above, direction], axis=1)
        for axis in (right, above):
            along = (cloud - target) @ axis
            target = target + 0.5 * (along.min() + along.max()) * axis
        outline_points = outermost((cloud - target) @ frame)
        for _ in range(CENTRED):  # what is near looks larger: the middle of the picture
            middle, mean = np.zeros(3), float(outline_points[:, 2].mean())
            distance = distance_of(outline_points, ASPECT)
            for i in (0, 1):
                along = outline_points[:, i] / (distance - outline_points[:, 2])
                middle[i] = 0.5 * (along.min() + along.max()) * (distance - mean)
            outline_points, target = outline_points - middle, target + frame @ middle
        least = 1e-3 * self.size
        outline_points[:, :2] = MARGIN * np.where(
            np.abs(outline_points[:, :2]) < least, least, outline_points[:, :2]
        )
        return direction, target, up, outline_points

    def data(self) -> str:
        """Return the scene as JSON, safe inside a <script> element; what `drawScene` takes."""
        arrays = Arrays()
        shapes = [
            {
                "kind": x.kind, "joint": x.joint, "pivot": x.name if x.kind == "joint" else "",
                "colour": x.colour, "corners": arrays.place(x.corners, "<f4"),
                "faces": arrays.place(x.faces, "<i4"),
            }
            for x in self.shapes
        ]  # fmt: skip
        direction, target, up, outline = (vector.tolist() for vector in self.camera)
        content = {
            "shapes": shapes, "films": [self._film(film, arrays) for film in self.films],
            "marks": dict(self.marks), "ramp": _ramp(SHADES), "unknown": UNKNOWN,
            "fov": float(ANGLE), "misfit": self.largest_misfit, "up": up, "direction": direction,
            "target": target, "outline": outline, "arrays": list(arrays),
            "ghosts": self._ghosts, "stretch": self._played,
        }  # fmt: skip
        return script_json(content)

    @property
    def _ghosts(self) -> dict[str, tuple[int, int, int]]:
        """Colours of the models whose ghosts are drawn, by their names."""
        names = next((film.ghosts for film in self.films if film.ghosts), ())
        colours = [*GHOSTS.values()]
        return {name: GHOSTS.get(name) or colours[i % 2] for i, name in enumerate(names)}

    @property
    def _played(self) -> list[float] | None:
        """Number of the film, first and last time of its stretch as charts count them [s], and that
        at which the ghost of the model before is farthest from the machine, which stays to be seen.
        """
        if self.stretch is None:
            return None
        number, first, last = self.stretch
        film = self.films[number]
        distances = np.zeros(len(film))
        for q in film.ghosts.values():
            travel = np.maximum(np.ptp(film.q, axis=0), 1e-300)
            distances = np.maximum(
                distances, np.nan_to_num(np.abs(q - film.q) / travel).max(axis=1)
            )
        inside = (film.t >= first) & (film.t <= last)
        farthest = film.t[np.where(inside, distances, -1.0).argmax()]
        zero = zero_of(film.t)
        return [number, *(float(x - zero) for x in (first, last, farthest))]

    def _film(self, film: Film, arrays: Arrays) -> dict[str, Any]:
        """Return times, poses, colours, gaps and arrows of a film, times as charts count them."""
        poses = self._poses(film.q)
        drawn = {name: np.isfinite(q).all(axis=1) for name, q in film.ghosts.items()}
        first = {name: int(x.argmax()) for name, x in drawn.items() if x.any()}
        ghosts = {
            name: {
                "first": k,
                "poses": arrays.place(self._poses(film.ghosts[name][drawn[name]]), "<f4"),
            }
            for name, k in first.items()
        }
        tips = self._tips(film)
        places = range(film.at.shape[1])
        ends = np.nan_to_num(np.stack([film.at, tips], axis=2))
        arrows = [
            {"colour": ENDS[i % 2], "ends": arrays.place(ends[:, i], "<f4")}
            for i in places
            if self.largest_force
        ]
        gaps = [film.at[:, i : i + 2] for i in places[::2]]
        return {
            "name": film.name, "t": arrays.place(film.t - zero_of(film.t), "<f8"),
            "poses": arrays.place(poses, "<f4"), "arrows": arrows, "ghosts": ghosts,
            "gaps": [arrays.place(gap, "<f4") for gap in gaps],
            "misfit": {j: arrays.place(x, "<f4") for j, x in film.misfit.items()},
        }  # fmt: skip

    def _poses(self, q: np.ndarray) -> np.ndarray:
        """Return rotations and origins (n, joints, 12) of all joints."""
        R, origin = poses_of(self.mechanism.model, q)
        return np.concatenate([R.reshape(*R.shape[:2], 9), origin], axis=2)

    def _tips(self, film: Film) -> np.ndarray:
        """Return where the arrows of a film end (n, K, 3) [m]."""
        scale = LONGEST * self.size / (self.largest_force or 1.0)
        return np.asarray(film.at + film.force * scale)

    @cached_property
    def html(self) -> str:
        """A page with the mechanism and its charts: no server, no network."""
        title = f"{self.mechanism.name} in 3-D"
        return report_page(title, "", (), self.charts, (self,)).decode()

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the page, whole or not at all.

        Args:
            path: of the .html file.

        Raises:
            IdentError: for another suffix, or where it cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() not in SUFFIXES:
            valid = ", ".join(SUFFIXES)
            raise IdentError(f"{path}: unknown suffix '{path.suffix}'; valid: {valid}")
        return write_all(path.parent, {path.name: self.html.encode()})[0]

    def serve(self, port: int = 0) -> Place:
        """Serve the page on 127.0.0.1 until `.stop()`.

        Args:
            port: 0 takes a free one.

        Raises:
            IdentError: if the port is taken or there is none such.
        """
        return Place(port).serve(self.html, lambda _: None)

    def __repr__(self) -> str:
        line = (
            f"view of {self.mechanism.name}: {len(self.mechanism.bodies.links)} bodies, "
            f"{len(self.films)} film(s) of {self.moments} pictures in all; "
            ".serve() opens it, .write('view.html') keeps it"
        )
        return "\n".join([line, *(f"  note: {note}" for note in self.notes)])

    def _repr_html_(self) -> str:
        return str(piece("document", self.html, f"{self.mechanism.name} in 3-D", HEIGHT))


def _ramp(shades: int = 9) -> list[list[int]]:
    return [list(bytes.fromhex(colour)) for colour in MAP[:: (SHADES - 1) // (shades - 1)]]


def _css(colour: Sequence[int]) -> str:
    return "#" + "".join(f"{part:02x}" for part in colour)


def _first(names: Sequence[str]) -> list[str]:
    return [*names[:SHOWN], *["…"] * (len(names) > SHOWN)]


@renders(Mechanism, "view")
def view_of(
    mechanism: Mechanism,
    experiments: Sequence[Any] = (),
    predictions: Sequence[Any] = (),
    most: int = MOST_PICTURES,
    ghosts: Mapping[int, Ghosts] | None = None,
) -> View:
    """Return the mechanism along experiments, with reactions and residuals of their predictions,
    and with ghosts by the number of their experiment.
    """
    notes: list[str] = []
    if not experiments:
        try:
            q = mechanism.assembled
        except MechanismError as error:  # a picture helps to see why
            q = mechanism.start
            notes.append(str(error))
        experiments = [SimpleNamespace(name="as assembled", t=np.zeros(1), q=q[None])]
    shapes, size, more = shapes_of(mechanism, experiments[0].q[0])
    nowhere = ", ".join(c.name for c in mechanism.closures if not c.frames)
    if nowhere and predictions:
        more.append(f"{nowhere}: λ acts along coordinates, at no place: no arrow is drawn")
    per_film = max(2, most // len(experiments))
    both = zip(experiments, predictions or [None] * len(experiments), strict=True)
    ghosts = ghosts or {}
    films = tuple(
        film_of(mechanism, e, p, per_film, ghosts.get(i)) for i, (e, p) in enumerate(both)
    )
    view = View(mechanism, shapes, size, films, (*notes, *more))
    if not ghosts:
        return view
    number, ghost = next(iter(ghosts.items()))
    ends = experiments[number].t[ghost.samples][[0, -1]]
    return replace(view, window=ghost.window, stretch=(number, float(ends[0]), float(ends[1])))
