"""Courses x of the drives: what they are worth, how near the limits they are, and both slopes.

Every row and every limited quantity depends on its own sample alone, (y, ẏ, ÿ) of d drives:

    ∂J/∂x = Σ_n (G_n ∘ ∂W_n/∂(y, ẏ, ÿ)) · basis_n        and so for B

5 d motions beside this one give all derivatives: central differences in y and ẏ, forward ones in
ÿ. W of rigid bodies is linear in ÿ and quadratic in ẏ, so that wide steps are exact there; in ẏ
they also see how dry friction changes sign at a reversal, which narrow ones would miss.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ident.excite.box import Box
from ident.excite.criterion import Criterion
from ident.excite.fourier import Fourier
from ident.excite.stage import Seen, Stage, resting
from ident.motion import Experiment

STEP = (1e-5, 0.06, 1e-3)  # of y, ẏ, ÿ: shares of half range, top speed and acceleration


@dataclass(frozen=True, eq=False)
class Scale:
    """What makes numbers of rows: W = A[:, :, keep] / (σ · size).

    Attributes:
        keep: (r,) columns of the base parameters; size: (r,) their usual size.
        sigma: (d,) expected noise of the torques [N m | N].
    """

    keep: np.ndarray
    size: np.ndarray
    sigma: np.ndarray

    def of(self, A: np.ndarray) -> np.ndarray:
        """W (n d, r) of rows A (n, d, k)."""
        W = A[:, :, self.keep] / self.size / self.sigma[:, None]
        return W.reshape(-1, len(self.keep))


@dataclass(frozen=True, eq=False)
class Track:
    """All that courses of one mechanism have in common.

    Attributes:
        stage, fourier, box: the equations, the family of series, the limits at samples.
        rest: the mechanism at home, at the n samples of a period.
        basis: (3, n, d, P) of the series at these samples.
    """

    stage: Stage
    fourier: Fourier
    box: Box
    rest: Experiment
    basis: np.ndarray

    def at(self, t: np.ndarray, box: Box) -> Track:
        """The same at other times t (n,) [s] and limits."""
        names, home = self.rest.independent, self.fourier.home
        rest = resting(self.stage.mechanism, names, home, t)
        return replace(self, box=box, rest=rest, basis=self.fourier.basis(t))

    def motion(self, x: np.ndarray, near: Experiment) -> tuple[Seen, np.ndarray] | None:
        """Rows and limited quantities of a course x (d, P); None where it breaks a limit."""
        e = self.stage.followed(near, self.fourier.placed(self.basis, x))
        if e is None:
            return None
        seen = self.stage.seen(e)
        z = self.box.quantities(seen.e)
        return (seen, z) if self.box.holds(z) else None


@dataclass(frozen=True, eq=False)
class Course:
    """One course inside the limits; a `Spot` of the search.

    Attributes:
        x: (d P,) flat; worth: J; barrier: B.
        seen: its rows; G: (n d, r) and dB: (n, Z), the slopes of J and B by W and z.
    """

    track: Track
    criterion: Criterion
    scale: Scale
    x: np.ndarray
    worth: float
    barrier: float
    seen: Seen
    z: np.ndarray
    G: np.ndarray
    dB: np.ndarray

    @classmethod
    def of(
        cls, track: Track, criterion: Criterion, scale: Scale, x: np.ndarray, near: Experiment
    ) -> Course | None:
        """The course x (d P,); None where it breaks a limit or determines nothing."""
        found = track.motion(x.reshape(track.fourier.shape), near)
        if found is None:
            return None
        return cls.judged(track, criterion, scale, x, *found)

    @classmethod
    def judged(
        cls, track: Track, criterion: Criterion, scale: Scale, x: np.ndarray, seen: Seen,
        z: np.ndarray,
    ) -> Course | None:  # fmt: skip
        """A motion that is known to keep the limits."""
        judged = criterion.at(scale.of(seen.A))
        if judged is None:
            return None
        B, dB = track.box.barrier(z)
        return cls(track, criterion, scale, x, judged[0], B, seen, z, judged[1], dB)

    def moved(self, x: np.ndarray) -> Course | None:
        """Another course, come to from this one."""
        return Course.of(self.track, self.criterion, self.scale, x, self.seen.e)

    def slopes(self) -> tuple[np.ndarray, np.ndarray]:
        """∂J/∂x and ∂B/∂x, (d P,) each."""
        n, d = self.basis.shape[1:3]
        slope = np.zeros((2, 3, n, d))
        for channel, u, dW, dz in self._beside():
            slope[0, channel, :, u] = (self.G * dW).reshape(n, -1).sum(axis=1)
            slope[1, channel, :, u] = (self.dB * dz).sum(axis=1)
        dJ, dB = np.einsum("scnd,cndp->sdp", slope, self.basis).reshape(2, -1)
        return dJ, dB

    @property
    def basis(self) -> np.ndarray:
        """(3, n, d, P)."""
        return self.track.basis

    def _beside(self) -> Iterator[tuple[int, int, np.ndarray, np.ndarray]]:
        """(channel, drive, ∂W, ∂z) of every derivative."""
        family = self.track.fourier
        here = family.placed(self.basis, self.x.reshape(family.shape))
        sizes = family.half, self._top(1), self._top(2)
        W = self.scale.of(self.seen.A)
        for channel in range(3):
            for u in range(here.shape[2]):
                h = STEP[channel] * sizes[channel][u]
                above = self._at(here, channel, u, h)
                below = (W, self.z) if channel == 2 else self._at(here, channel, u, -h)
                width = h if channel == 2 else 2 * h
                if above is not None and below is not None:
                    yield channel, u, (above[0] - below[0]) / width, (above[1] - below[1]) / width

    def _top(self, channel: int) -> np.ndarray:
        """(d,) the largest rate or acceleration of this course."""
        e = self.seen.e
        at = [self.track.stage.mechanism.joint_index[name] for name in e.independent]
        return np.abs((e.y, e.yd, e.ydd)[channel][:, at]).max(axis=0)

    def _at(
        self, here: np.ndarray, channel: int, u: int, h: float
    ) -> tuple[np.ndarray, np.ndarray] | None:
        states = here.copy()
        states[channel, :, u] += h
        e = self.track.stage.followed(self.seen.e, states)
        if e is None:
            return None
        seen = self.track.stage.seen(e)
        return self.scale.of(seen.A), self.track.box.quantities(seen.e)
