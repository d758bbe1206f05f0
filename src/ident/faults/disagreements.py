"""Which of several logs disagree with the others, and in which parameter.

Were a log like all others but for one unknown j, that unknown would differ by δ_j:

    r = g − H (H + H_o)⁺ (g + g_o)        the log's score at the fit of it and the others together
    P = H (H + H_o)⁺ H_o                  what both determine of a difference
    δ_j = w_jᵀ r / w_jᵀ P w_j             z_j = δ_j / √Var δ_j

H = Σ AᵀA / σ², g = Aᵀ(b − A x) / σ² of the log, H_o, g_o of all others; w_j: what j changes of the
base parameters. Var r is that of white residuals, of each log by what its own fit leaves, times the
ratio that blocks of all logs in their own fits show along w_j (`information.chance`): a difference
between logs is in neither. Of m unknowns p = m min_j p_j (Bonferroni). A log that disagrees makes
the others look odd: the one that does so most is set aside, and the rest judged again without it,
until none is left or the majority would be lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import compress

import numpy as np

from ident.equations.problem import Problem
from ident.equations.unknowns import Columns
from ident.faults.channel_fits import DOUBT
from ident.finding import Finding
from ident.information import linear
from ident.information.blocks import Information, Squares
from ident.information.chance import FEWEST_SQUARES, held_out, long_run, scores
from ident.information.estimate import Estimate, estimate
from ident.information.evidence import (
    ALPHA,
    MAIN_CAUSE,
    credible,
    leaves_as_little,
    nearly_best,
    surprise,
)
from ident.text import percent, shortlist

SAME = 1e-6  # numerics: of the largest fall of squared error, within which two are the same
TOLD_APART = 1e7  # numerics: condition number of the columns that one log tells apart
UNKNOWN = 1e-12  # numerics: of H's largest eigenvalue, below which nothing is determined
# tuned: of ν: far out in the tail it counts that ν itself is estimated; with all of it 5 to 13 of
# 100 sets of like logs disagree where noise is correlated over a block
BELIEVED = 0.5
LEAST_NOISE = 0.01, 1e-3  # numerics: of σ² of a log's rows, of the joint residual


@dataclass(frozen=True)
class Disagreement:
    """Difference of one log from the majority of the others."""

    p_value: float  # chance that a log like the others looks as odd as this one
    clear: bool  # whether that is less than `ALPHA` over the number of logs
    unknown: str  # that alone explains it best
    change: float  # by how much it differs
    stderr: float
    unit: str
    # bodies and effects of which each alone explains it nearly as well as the best, that first
    parts: tuple[str, ...]
    share: float  # of the excess of squared error, that the best explains


@dataclass(frozen=True, eq=False)
class OwnFits:
    """Logs in fits of their own, beside the fit of all of them."""

    problem: Problem  # the equations of all logs

    @cached_property
    def by_log(self) -> dict[int, Information]:
        """The equations of each log."""
        information = self.problem.information
        return {log: information.of_log(log) for log in information.logs}

    @cached_property
    def joint(self) -> Estimate:
        """The estimate from all logs."""
        return self.problem.estimate(free=True)

    @cached_property
    def solutions(self) -> dict[int, np.ndarray]:
        """(k,) unknowns by log; those of the joint estimate where a log leaves them open."""
        x, solutions = self.joint.x, dict[int, np.ndarray]()
        for log, log_information in self.by_log.items():
            good = len(x) and any(triangle.rows for triangle in log_information.totals)
            solutions[log] = self._estimate(log_information, self.joint.sigma).x if good else x
        return solutions

    @cached_property
    def held_out(self) -> Squares | None:
        """Errors of each log in stretches that its own fit did not see; None where one has none."""
        total = Squares.zero(self.problem.information.d)
        for log_information in self.by_log.values():
            fitted, base = self.joint, self.joint.base.independent
            columns = np.concatenate([t.stack()[:, base] for t in log_information.totals])
            norms = np.linalg.norm(columns, axis=0)
            # what other logs have of their own, or alone tell apart, is not in this one
            if not norms.all() or np.linalg.cond(columns / norms) > TOLD_APART:
                fitted = self._estimate(log_information, self.joint.sigma)
            squares = held_out(log_information, log_information, fitted, self.problem.prior)
            if squares is None:
                return None
            total = total + squares
        return total

    @cached_property
    def weighed(self) -> Estimate:
        """The estimate from all logs, with what fits of each leave as the noise."""
        information = self.problem.information
        error, rows = np.zeros((2, information.d))
        for log, log_information in self.by_log.items():
            error += [
                triangle.residual_norm(self.solutions[log]) ** 2
                for triangle in log_information.totals
            ]
            rows += [triangle.rows for triangle in log_information.totals]
        sigma = np.sqrt(error / np.maximum(rows, 1))
        return self._estimate(information, np.maximum(sigma, LEAST_NOISE[1] * self.joint.sigma))

    def _estimate(self, information: Information, sigma: np.ndarray) -> Estimate:
        r, fixed = self.problem, self.joint.fixed
        return estimate(information.totals, r.prior, r.torque, sigma=sigma, fixed=fixed)


def disagreements(
    information: Information, joint: Estimate, columns: Columns
) -> Mapping[int, Disagreement]:
    """Find which logs disagree with the majority."""
    numbers = sorted({log for log, _ in information.times})
    if len(numbers) < 2 or not joint.base.rank:
        return {}
    logs, least, agreeing = _Logs(information, joint, columns), ALPHA / len(numbers), numbers
    while True:
        tests = {i: logs.against(agreeing, i, least) for i in numbers}
        odd = {i: tests[i][1] for i in agreeing if tests[i][0].clear}
        if not odd or 2 * (len(agreeing) - 1) <= len(numbers):
            return {i: disagreement for i, (disagreement, _) in tests.items()}
        worst = max(odd, key=lambda i: odd[i])
        agreeing = [i for i in agreeing if i != worst]


class _Logs:
    """Logs in the n base parameters, scaled to columns of unit norm."""

    def __init__(self, information: Information, joint: Estimate, columns: Columns) -> None:
        base, self.columns = joint.base, columns
        norm = joint.triangle.column_norms()[base.independent]
        ways = np.zeros((base.rank, len(joint.solution.x)))
        ways[np.arange(base.rank), base.independent] = 1.0
        ways[:, base.dependent] = base.K
        self.ways = ways * norm[:, None]  # (n, k) what a unit of each unknown changes of them
        parts: dict[str, list[int]] = {}
        for i in range(len(columns.rigid)):
            parts.setdefault(columns.names[i].rpartition(".")[0], []).append(i)
        for effect, places in columns.effects:
            if own_step := [int(place) for place in places if place >= 0]:
                parts[effect.label] = own_step
        # unknowns by body and effect, those of the fewest first
        self.parts = dict(sorted(parts.items(), key=lambda item: len(item[1])))
        # by log: H (n, n) and g (n,) at the estimate, s², S (n, n), the covariance of g of its
        # blocks in its own fit over s², and the number of squares that this rests on
        self.H, self.g, self.noise, self.S, self.nu = {}, {}, {}, {}, {}
        for log in information.logs:
            own_rows = information.of_log(log)
            keys, H_b, g_b = scores(own_rows, joint, norm)
            if not keys:
                continue
            H, g, total = H_b.sum(axis=0), g_b.sum(axis=0), own_rows.total(joint.sigma)
            inverse = _inverse(H)
            own_step = inverse @ g
            others = _inverse(H - H_b)
            # at the fit of all others
            errors = (others @ (g_b - H_b @ own_step)[..., None])[..., 0] @ H
            spare = total.rows - np.linalg.matrix_rank(inverse)
            remaining = (total.residual_norm(joint.x) ** 2 - float(g @ own_step)) / max(spare, 1)
            self.H[log], self.g[log], self.noise[log] = H, g, max(remaining, LEAST_NOISE[0])
            S, nu = long_run(keys, errors, np.diagonal(H_b, axis1=1, axis2=2))
            self.S[log], self.nu[log] = S / self.noise[log], float(np.median(nu))

    def against(
        self, agreeing: Sequence[int], log: int, least: float
    ) -> tuple[Disagreement, float]:
        """Compare a log with all others of those that agree; it is clear from p < `least` on.

        Returns also the fall of the squared error if it may have parameters of its own.
        """
        from scipy.special import stdtr  # takes 0.1 s to import

        others, W = [i for i in agreeing if i != log], self.ways
        H, H_o = self.H[log], np.sum([self.H[i] for i in others], axis=0)
        share = H @ _inverse(H + H_o)
        r = self.g[log] - share @ np.sum([self.g[i] for i in (log, *others)], axis=0)
        P = share @ H_o
        P = 0.5 * (P + P.T)
        h = _along(P, W)
        known = np.flatnonzero(h > UNKNOWN * _along(H + H_o, W))
        if not len(known):
            return Disagreement(1.0, False, "", 0.0, np.nan, "", (), 0.0), 0.0
        W, h = W[:, known], h[known]
        M, noise = np.eye(len(H)) - share, sum(self.noise[i] * self.H[i] for i in others)
        white = self.noise[log] * M @ H @ M.T + share @ noise @ share.T
        by_log = np.array([_along(S, W) for S in self.S.values()])
        longer = by_log.sum(axis=0) / _along(np.sum(list(self.H.values()), axis=0), W)
        nus = np.array(list(self.nu.values()))[:, None]
        nu = BELIEVED * by_log.sum(axis=0) ** 2 / np.maximum((by_log**2 / nus).sum(axis=0), 1e-300)
        delta, stderr = W.T @ r / h, np.sqrt(np.maximum(longer, 1.0) * _along(white, W)) / h
        p = 2 * stdtr(np.maximum(nu, FEWEST_SQUARES), -np.abs(delta / stderr))
        chance = float(min(1.0, len(known) * p.min()))
        fall, shares = float(r @ _inverse(P) @ r), {}
        for name, unknowns in self.parts.items():  # what each part explains by itself
            D = W[:, np.isin(known, unknowns)]
            own_rows = (D.T @ r) @ linear.pinv(D.T @ P @ D, rcond=1e-9, hermitian=True) @ (D.T @ r)
            shares[name] = float(np.clip(own_rows / fall, 0.0, 1.0)) if fall > 0 else 0.0
        best = max(shares.values(), default=0.0)
        near = [*compress(shares, nearly_best([*shares.values()]))]
        explained = delta**2 * h  # of multiples of each other the first
        j = int((explained >= (1 - SAME) * explained.max()).argmax())
        clear = credible(surprise(chance), surprise(least))
        odd = Disagreement(
            chance, clear, self.columns.names[known[j]], float(delta[j]), float(stderr[j]),
            self.columns.units[known[j]], tuple(sorted(near, key=lambda n: -shares[n])), best,
        )  # fmt: skip
        return odd, fall


def _along(S: np.ndarray, D: np.ndarray) -> np.ndarray:
    """dᵀ S d (m,) for each direction d of D (n, m)."""
    return np.asarray((D * (S @ D)).sum(axis=0))


def _inverse(H: np.ndarray) -> np.ndarray:
    """Inverse in the directions that H (…, n, n) determines."""
    return linear.pinv(H, rcond=UNKNOWN, hermitian=True)


def differing_logs(problem: Problem, reference: Callable[[], np.ndarray]) -> Iterator[Finding]:
    """Report logs that disagree, where fits of each predict stretches of it that were left out with
    less than half of the error of a joint that one fit of all of them leaves, and no effect that
    acts in all logs explains as much: something was changed between them. `reference` gives (d,)
    relative errors with all linear effects of the library.
    """
    motion, information, fits = problem.motion, problem.information, OwnFits(problem)
    if not len(motion.logs) == len(motion.experiments) == len(information.logs):
        return  # stretches of a long log are no logs, and those of a gathered fit have a table
    together = held_out(information, information, fits.joint, problem.prior)
    apart = fits.held_out
    if together is None or apart is None:
        return
    torque = np.where(problem.torque > 0, problem.torque, np.inf)
    before, after = (
        np.sqrt(x.in_motion[0] / np.maximum(x.in_motion[2], 1)) / torque for x in (together, apart)
    )
    u = int((before - after).argmax())
    if not credible(before[u], DOUBT, remaining=after[u], most=MAIN_CAUSE * before[u]):
        return
    if not leaves_as_little(after, reference()):
        return  # an effect that is missing in all of them explains it
    names = motion.names
    differ = disagreements(information, fits.weighed, problem.columns)
    odd = {names[i]: disagreement for i, disagreement in differ.items() if disagreement.clear}
    if odd:
        changed = [
            f"{name} in {shortlist(disagreement.parts, 2)}"
            for name, disagreement in odd.items()
            if disagreement.parts
        ]
        what = f"; {shortlist(changed, 3)} most" if len(odd) < len(names) and changed else ""
        joint = motion.independent[u]
        text = (
            f"the logs disagree{what}: each by itself leaves {percent(after[u])} of tau.{joint}, "
            f"all together {percent(before[u])}: something was changed between them"
        )
        remedy = (
            "identify those that belong together, with --out DIR; then ident diagnose "
            "DIR/identified LOG names what has changed in another one"
        )
        yield Finding("logs disagree", text, remedy, tuple(odd), float(before[u]), DOUBT)
