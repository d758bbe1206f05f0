"""Numbers as servos and encoders write them: a sign in a bit of its own, angles within one turn.

    sign and magnitude       raw = |x| + S where x < 0, S a power of two above all magnitudes
    within a turn            q − 2π k(t), k(t) an integer that changes where q passes an end

Both are recognised by what undoing them leaves: a series without the jumps. Nothing is
changed without a note.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.log import Column
from ident.mechanism.mechanism import Mechanism

BITS = range(5, 17)  # range: places of a sign's bit
INTEGER = 1e-6  # numerics: of 1, by which a raw number may be off an integer
WORDS = (8, 16, 32)  # range: bits of an integer
EMPTY = 0.05  # range: of the largest number, beside which there is none
MUCH = 4.0  # range: times smaller must steps at changes of sign become
BOTH = 0.02  # range: share of the samples that each sign has at least
TURN = 2 * np.pi  # range: rad
NEAR = 0.25  # range: of a turn, by which a step may differ from one, as of a joint that moves fast
ENOUGH = 20  # work: samples that tell


def signed(
    columns: Mapping[str, np.ndarray], sources: Mapping[str, Column]
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return the torques (n,) that have their sign in a bit of its own, with their signs, by name,
    and a note of each kind.

    Args:
        columns: of a log in SI, by ident's names.
        sources: by name, the scale and offset that made it of integers.
    """
    changed: dict[str, np.ndarray] = {}
    names: dict[int, list[str]] = {}
    unsigned: dict[int, list[str]] = {}
    for name in (name for name in columns if name.startswith("tau.")):
        source = sources.get(name)
        scale, offset = (source.scale, source.offset) if source else (1.0, 0.0)
        raw = (columns[name] - offset) / scale
        if (bits := wrapped_bits(raw[np.isfinite(raw)])) is not None:
            value = np.where(raw >= 2 ** (bits - 1), raw - 2**bits, raw)
            changed[name] = scale * value + offset
            unsigned.setdefault(bits, []).append(name)
        elif (bit := sign_bit(raw[np.isfinite(raw)])) is not None:
            value = np.where(raw >= bit, bit - raw, raw)
            changed[name] = scale * value + offset
            names.setdefault(bit, []).append(name)
    notes = [
        f"{', '.join(of)}: never negative, nothing just below {bit}, and smooth where what is from "
        f"{bit} on is taken as {bit} − value: sign and magnitude, the sign in a bit of its own; "
        "signs are restored"
        for bit, of in names.items()
    ]
    notes += [
        f"{', '.join(of)}: never negative, nothing between, and smooth where what is from "
        f"{2 ** (bits - 1)} on is taken less {2**bits}: signed numbers of {bits} bits read as "
        "unsigned; signs are restored"
        for bits, of in unsigned.items()
    ]
    return changed, notes


def wrapped_bits(raw: np.ndarray) -> int | None:
    """Return the bits of signed integers (n,) that were read as unsigned; None of other numbers."""
    if len(raw) < ENOUGH or raw.min() < 0 or np.abs(raw - np.rint(raw)).max() > INTEGER:
        return None
    for bits in WORDS:
        half = 2.0 ** (bits - 1)
        high = raw >= half
        inside = raw.max() < 2 * half and BOTH < float(high.mean()) < 1 - BOTH
        if not inside or (np.abs(raw - half) < EMPTY * half).any():  # nothing is near the ends
            continue
        value = np.where(high, raw - 2 * half, raw)
        at = np.flatnonzero(high[1:] != high[:-1])
        after, before = (float(np.abs(np.diff(x))[at].sum()) for x in (value, raw))
        if MUCH * after < before:
            return bits
    return None


def sign_bit(raw: np.ndarray) -> int | None:
    """Return the power of two that stands for the sign in numbers (n,); None where none does."""
    if len(raw) < ENOUGH or raw.min() < 0 or np.abs(raw - np.rint(raw)).max() > INTEGER:
        return None
    for bit in (2**k for k in BITS):
        high = raw >= bit
        share = float(high.mean())
        if not BOTH < share < 1 - BOTH or raw[high].max() >= 2 * bit:
            continue
        if raw[~high].max() >= bit - 1:  # magnitudes are below it, with a gap
            continue
        value = np.where(high, bit - raw, raw)
        at = np.flatnonzero(high[1:] != high[:-1])
        step, before = (np.abs(np.diff(x))[at] for x in (value, raw))
        nearest = np.minimum(np.abs(value[at]), np.abs(value[at + 1]))
        small = float(np.median(nearest)) < float(np.quantile(np.abs(value), 0.25))
        if 2 * step.sum() < before.sum() and small:  # signs change near zero
            return bit
    return None


def unwrapped(
    mechanism: Mechanism, t: np.ndarray, columns: Mapping[str, np.ndarray], longest: float
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return the positions (n,) of turning joints that jump by turns, without the jumps, by name,
    and a note. Across steps of t (n,) that are longer than `longest` [s] nothing is concluded.
    """
    changed, notes = {}, []
    for joint in mechanism.joints:
        name = f"q.{joint.name}"
        if not joint.rotational or name not in columns:
            continue
        known = np.flatnonzero(np.isfinite(columns[name]))
        x = columns[name][known]
        step, usual = np.diff(x), np.diff(t[known]) <= longest
        turns = np.rint(step / TURN)
        jump = (turns != 0) & usual & (np.abs(step - turns * TURN) < NEAR * TURN)
        largest_step = np.abs(step[~jump & usual]).max(initial=0.0)
        if not jump.any() or len(known) < ENOUGH or largest_step > NEAR * TURN:
            continue
        count = np.cumsum(np.where(jump, turns, 0.0))
        if (np.abs(np.diff(np.flatnonzero(jump))) == 1).any():  # a lone sample, no turn
            continue
        smooth = columns[name].astype(float)
        smooth[known[1:]] -= TURN * count
        changed[name] = smooth
        notes.append(
            f"{name} jumps by 2π {int(jump.sum())} times (first at t = "
            f"{t[known][1:][jump][0]:.4g} s): the encoder counts within one turn; unwrapped"
        )
    return changed, notes
