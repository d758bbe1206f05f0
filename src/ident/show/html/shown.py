"""Old place of `Shown` and `in_frame`, until all callers take them from `ident.show.html`."""

from ident.show.html.elements import Shown, in_frame

__all__ = ["Shown", "in_frame"]
