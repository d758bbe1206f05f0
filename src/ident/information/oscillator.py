"""Two masses with a spring or with play between them, where the motion of one is given.

M δ̈ + D δ̇ + δ/c = L        δ: first less second, M of the second, L: what the second would
                            need to move as the first does, c compliance, D damping
M δ̈ = L, |δ| ≤ w/2         with play w between stops in which δ̇ is lost
"""

from __future__ import annotations

import numpy as np

from ident.information.lapack import lapack

# of central differences of the sixth order: coefficients of f(t + h) ∓ f(t − h), …, and of f(t)
FIRST = np.array([45.0, -9.0, 1.0]) / 60
SECOND, CENTRE = np.array([270.0, -27.0, 2.0]) / 180, -490.0 / 180
MOST_TURNS = 300.0  # numerics: of an exponent, beyond which what has decayed is 0
SHORT = 1e-3  # numerics: of a step, a flight at least
AT_ONCE = 64  # work: samples among which the end of a flight is looked for first


def rates(x: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return ẋ and ẍ (n, …) of series x (n, …) with a step of time [s]; at its ends x goes straight
    on.
    """
    k, n = len(FIRST), len(x)
    ahead = np.arange(1, k + 1).reshape(-1, *[1] * (x.ndim - 1))
    slopes = (x[1] - x[0], x[-1] - x[-2]) if n > 1 else (0.0 * x[0], 0.0 * x[0])
    before, after = x[0] - ahead[::-1] * slopes[0], x[-1] + ahead * slopes[1]
    padded = np.concatenate([before, x, after])
    first, second = np.zeros(x.shape), CENTRE * x
    for i, (a, b) in enumerate(zip(FIRST, SECOND, strict=True), 1):
        ahead_of, behind = padded[k + i : k + i + n], padded[k - i : k - i + n]
        first, second = first + a * (ahead_of - behind), second + b * (ahead_of + behind)
    return first / step, second / step**2


def sprung(
    step: float,
    loads: np.ndarray,
    carried: tuple[np.ndarray, np.ndarray, np.ndarray],
    compliance: float,
    damping: float,
    start: np.ndarray | None = None,
    finest: float = 0.0,
) -> np.ndarray:
    """Return δ, δ̇, δ̈ (3, n, m) of a spring; see above.

    δ = c L + ε, where ε has the rest of the equation for its force and vanishes with c², so that
    slopes at c = 0 are exact. Within a step M stays and the force is straight: the solution is that
    of an oscillator, however short its period; one with more than half a swing a step is damped.
    It is linear in the load: of several, all together.

    Args:
        step: of time [s]; loads: m of them, L [N m | N] (n, m).
        carried: M [kg m² | kg] (n,), and what the second mass adds by itself to D and to 1/c (n,).
        compliance, damping: c [rad/(N m) | m/N], D [N m s/rad | N s/m].
        start: δ (m,) of the first sample, at rest; by default it goes there with its load, ε = 0.
        finest: [s] half of the shortest period that loads have; by default a step.
    """
    (n, m), inertia, damps, stiffness = loads.shape, *(x[:, None] for x in carried)
    if compliance <= 0 or n < 2:
        first, second = rates(loads, step) if n > 1 else (np.zeros((n, m)), np.zeros((n, m)))
        return compliance * np.stack([loads, first, second])
    first, second = rates(loads, step)
    D, K = damping + damps, 1 / compliance + stiffness
    # where no load is, it would ring with errors alone, and above half the rate of the samples at
    # another frequency
    swing = np.sqrt(np.maximum(K / inertia, 0.0))
    more = swing * np.clip(swing * max(step, finest) / np.pi - 1, 0.0, 1.0)
    every = 0.5 * D / inertia + more, K / inertia
    a, b = (0.5 * (x[1:] + x[:-1]) for x in every)  # (n − 1, 1)
    # ε̈ + 2 a ε̇ + b ε = g
    g = -compliance * (second + (D * first + stiffness * loads) / inertia)
    around = np.pad(g, ((1, 1), (0, 0)), mode="edge")
    g = g - (around[2:] - 2 * g + around[:-2]) / 12  # straight pieces are as large as g in the mean
    g0, slope = g[:-1], np.diff(g, axis=0) / step
    # cos x and sin x / root where it swings, cosh and sinh where it creeps
    root, swings = np.sqrt(np.abs(b - a**2)), b >= a**2
    short = root * step < 1e-6  # near critical damping
    root, swings = np.where(short, 1e-6 / step, root), swings | short
    decay = np.exp(-np.clip(a * step, -MOST_TURNS, MOST_TURNS))
    x = root * step
    cosine, sine = decay * np.cos(x), decay * np.sin(x) / root
    if not swings.all():
        creeps = ~swings
        exponents = -step * np.stack([a - root, a + root])[:, creeps]
        slow, fast = np.exp(np.clip(exponents, -MOST_TURNS, MOST_TURNS))
        cosine[creeps] = 0.5 * (slow + fast)
        sine[creeps] = 0.5 * (slow - fast) / root[creeps]
    # ε = p0 + p1 s + homogeneous, from its values at the beginning of a step
    p1 = slope / b
    p0 = g0 / b - 2 * a * slope / b**2
    F = cosine + a * sine, sine, -b * sine, cosine - a * sine  # of [ε, ε̇], by row
    right = np.zeros((n, 2, m))
    if start is not None:
        right[0] = start - compliance * loads[0], -compliance * first[0]
    right[1:, 0] = p0 + p1 * step - F[0] * p0 - F[1] * p1
    right[1:, 1] = p1 - F[2] * p0 - F[3] * p1
    # x_{k+1} = F_k x_k + forced_k: one lower triangle with three diagonals below
    band = np.zeros((4, 2 * n))
    band[0] = 1.0
    band[1, 1 : 2 * (n - 1) : 2] = -F[1][:, 0]
    band[2, 0 : 2 * (n - 1) : 2], band[2, 1 : 2 * (n - 1) : 2] = -F[0][:, 0], -F[3][:, 0]
    band[3, 0 : 2 * (n - 1) : 2] = -F[2][:, 0]
    x, _ = lapack.dtbtrs(band, right.reshape(2 * n, m), uplo="L")
    e, rate = x.reshape(n, 2, m).transpose(1, 0, 2)
    delta, speed = compliance * loads + e, compliance * first + rate
    acceleration = -(D * speed + e / compliance + stiffness * delta) / inertia - 2 * more * rate
    return np.stack([delta, speed, acceleration])


def with_play(step: float, load: np.ndarray, inertia: np.ndarray, width: float) -> np.ndarray:
    """Return δ (n,) between stops that are `width` apart; see above.

    The second mass leans on a stop while its load presses it there, flies where the load changes
    sign, and stays at the stop where it lands.

    Args:
        step: of time [s]; load, inertia: L [N m | N], M [kg m² | kg] (n,).
        width: w [rad | m], 0 or more.
    """
    n, half = len(load), 0.5 * width
    g = load / inertia
    if n < 2 or half <= 0:
        return half * np.sign(g)
    slope = np.diff(g) / step
    speed = np.concatenate([[0.0], np.cumsum(0.5 * step * (g[1:] + g[:-1]))])
    way = np.cumsum(speed[:-1] * step + g[:-1] * step**2 / 2 + slope * step**3 / 6)
    way = np.concatenate([[0.0], way])  # ∫∫ g

    def at(t: float) -> tuple[float, float]:
        """∫ g and ∫∫ g at a time."""
        k = min(int(t / step), n - 2)
        s = t - k * step
        return (
            speed[k] + g[k] * s + slope[k] * s**2 / 2,
            way[k] + speed[k] * s + g[k] * s**2 / 2 + slope[k] * s**3 / 6,
        )

    delta = np.empty(n)
    # where its sign changes: between these samples and the next, or at the last one without load
    last_loaded = np.maximum.accumulate(np.where(g != 0, np.arange(n), 0))
    positive = g[last_loaded] >= 0
    turns = np.flatnonzero(positive[:-1] != positive[1:])
    times = (turns + g[turns] / (g[turns] - g[turns + 1])) * step
    now, side, done = 0.0, 1.0 if g[0] >= 0 else -1.0, 0  # samples that are done
    while done < n:
        k = min(int(now / step), n - 2)
        if side * (g[k] + slope[k] * (now - k * step)) >= 0:  # it leans on until the load turns
            following = np.searchsorted(times, now, side="right")
            now = float(times[following]) if following < len(times) else n * step
            end = min(int(now / step) + 1, n)
            delta[done:end], done = side * half, end
        fast, far = at(now)
        place, at_place, size = now, side * half, AT_ONCE  # the end of the flight so far
        while done < n:
            samples = np.arange(done, min(done + size, n))
            path = side * half + way[samples] - far - fast * (samples * step - now)
            beyond = np.flatnonzero(np.abs(path) > half)
            out = int(beyond[0]) if len(beyond) else len(path)
            delta[samples[:out]], done = path[:out], done + out
            if out:
                place, at_place = samples[out - 1] * step, path[out - 1]
            if len(beyond):  # it lands between this sample and the one before
                side = float(np.sign(path[out]))
                share = np.clip((side * half - at_place) / (path[out] - at_place), 0.0, 1.0)
                now = max(place + float(share) * (samples[out] * step - place), now + SHORT * step)
                if done * step <= now:
                    delta[done], done = side * half, done + 1
                break
            size *= 2
    return delta
