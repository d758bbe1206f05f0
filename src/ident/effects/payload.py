"""Something that a link carries."""

from __future__ import annotations

import numpy as np

from ident.effects.effect import Effect, Signals, Unknown

WORDS = ("m", "mx", "my", "mz", "Lxx", "Lxy", "Lyy", "Lxz", "Lyz", "Lzz")


class Payload(Effect):
    """A body on a link, with ten parameters about the frame of the link's joint."""

    kind = "payload"
    sits = "link"
    watched = "always"
    unknowns = tuple(
        Unknown(word, (unit, unit), meaning, acts="body")  # a load put down has a negative mass
        for word, unit, meaning in zip(
            WORDS,
            ("kg", *["kg m"] * 3, *["kg m²"] * 6),
            ("mass", *["first moment"] * 3, *["moment about the joint frame's origin"] * 6),
            strict=True,
        )
    )
    equation = "Γ_link p, the link's own columns once more"
    signature = "all joints below the link show one more load, in proportion to it"
    confused_with = ("the link's own parameters, as long as these are unknown",)
    remedy = "log the same motion with the load and without it"
    source = "Khalil, Gautier, Lemoine, IEEE ICRA 2007"

    def columns(self, s: Signals) -> np.ndarray:
        return np.zeros((*s.q.shape, len(self.unknowns)))
