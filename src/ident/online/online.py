"""`Online`: a mechanism identified while it moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.errors import FitError, LogError
from ident.fit import Fit
from ident.fit.settle import settled
from ident.mechanism import Mechanism, Multipliers
from ident.motion import Motion, complete
from ident.online import reactions
from ident.online.causal import check_causal, held
from ident.online.intake import Sample
from ident.online.recursion import Recursion
from ident.online.snapshot import Snapshot
from ident.online.stream import LATENCY
from ident.online.warmup import Warmup

WARMUP = 5.0  # [s] from which a stream learns what it is like


class Online:
    """Identifies a mechanism sample by sample, in constant memory.

    The equations are those of `identify` with the estimator least-squares. Where nothing is
    filtered and positions, velocities and accelerations are given, parameters are the same after
    every sample; else they are a fixed lag late.

    Args:
        mechanism: with what is unknown and which effects it has.
        like: a motion of the same machine, or a fit, from which is taken what a batch chooses from
            the whole log: the filter, smoothing, speeds of standstill; and values of shapes, which
            are held. Without it the first seconds are kept and looked at; they count like all
            others, and should show the machine moving as it will.
        forget: time constant [s] after which an equation counts e times less; None: all count
            alike.
        latency: how long samples may wait for others [s]: rows are made faster together.
        warmup: how many seconds are looked at where `like` is not given.
        cutoff, smoothing: as `complete` takes them, where `like` is not given.

    Raises:
        FitError: for an effect that cannot be had sample by sample, or a time that is none.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        *,
        like: Motion | Fit | None = None,
        forget: float | None = None,
        latency: float = LATENCY,
        warmup: float = WARMUP,
        cutoff: float | str | None = "auto",
        smoothing: float | str | None = "auto",
    ) -> None:
        check_causal(mechanism)
        _check_time("latency", latency, least=0.0)
        _check_time("warmup", warmup)
        if forget is not None:
            _check_time("forget", forget)
        notes = []
        if mechanism.multipliers.basis != "free":
            notes.append(
                f"multipliers are free, one value a sample, and not {mechanism.multipliers.basis}"
            )
            mechanism = replace(mechanism, multipliers=Multipliers())
        self.mechanism, self.notes = mechanism, tuple(notes)
        self._forget, self._latency = forget, latency
        self._cutoff, self._smoothing = cutoff, smoothing
        self._warmup = self._emptied(warmup)
        self._recursion = None if like is None else self._of(like)

    @property
    def samples(self) -> int:
        """How many have come."""
        return self._recursion.stream.samples if self._recursion else len(self._warmup)

    @property
    def warm(self) -> bool:
        """Whether the warm-up is over."""
        return self._recursion is not None

    @property
    def t(self) -> float:
        """Time of the last sample [s]; NaN before the first."""
        return self._recursion.stream.t if self._recursion else self._warmup.t

    @property
    def lag(self) -> float:
        """By how much equations are behind the last sample at most [s]; NaN in the warm-up."""
        return self._recursion.stream.lag if self._recursion else float("nan")

    @property
    def multipliers(self) -> reactions.Multipliers | None:
        """λ of the samples that the last `update` or `snapshot` completed, by the parameters of the
        last snapshot; None before the first one, for a tree, and where none was completed.
        """
        return self._recursion.multipliers if self._recursion else None

    def update(self, sample: Sample) -> None:
        """Takes a sample or a block of them.

        Args:
            sample: numbers, or arrays (n,), by column, under this robot's own names or ident's:
                `t`, `q.<joint>`, `tau.<joint>`, …; or a `Log`.

        Raises:
            LogError: for a sample that is not whole, or not later than those before. It is left
                out, and others may follow.
            MotionError: if the first seconds do not determine the motion.
        """
        if self._recursion is not None:
            self._recursion.push(sample)
        elif self._warmup.keep(sample):
            self._look()

    def snapshot(self) -> Snapshot:
        """Parameters, multipliers and errors by now; it ends a warm-up.

        Raises:
            FitError: if no equation is known yet.
            LogError, MotionError: if the samples so far do not determine the motion.
        """
        if self._recursion is None:
            self._look()
        assert self._recursion is not None
        found = self._recursion.snapshot()
        return replace(found, notes=(*self.notes, *found.notes))

    def _look(self) -> None:
        """Learns from the samples that were kept, and takes them like all others."""
        if not len(self._warmup):
            raise LogError(f"{self.mechanism.name}: no sample yet; give `update` some")
        log = self._warmup.log()
        like = complete(self.mechanism, log, cutoff=self._cutoff, smoothing=self._smoothing)
        self.notes = (*self.notes, *like.notes)
        self._recursion = self._of(like)
        self._recursion.push(log)
        self._warmup = self._emptied(0.0)

    def _emptied(self, seconds: float) -> Warmup:
        reads = [name for effect in self.mechanism.effects for name in effect.reads()]
        return Warmup(self.mechanism.name, self.mechanism.columns, reads, seconds)

    def _of(self, like: Motion | Fit) -> Recursion:
        motion = like.motion if isinstance(like, Fit) else like
        start = like.point if isinstance(like, Fit) else None
        if not isinstance(motion, Motion):
            raise FitError(
                f"like needs a motion or a fit, given: {type(like).__name__}; write "
                "like=ident.complete(mechanism, log)"
            )
        point = settled(self.mechanism, motion, start)
        known = held(self.mechanism, point)
        return Recursion(known, motion, point, self._forget, self._latency)


def _check_time(name: str, value: float, least: float = 1e-9) -> None:
    """Refuse what is no time.

    Raises:
        FitError: saying what is valid.
    """
    if not (np.isfinite(value) and value >= least):
        raise FitError(f"{name} {value:g}; valid: a time in seconds{', above 0' if least else ''}")
