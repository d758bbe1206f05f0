"""Panel, which this package alone needs, and how Jupyter gets its scripts."""

from __future__ import annotations

import base64
from functools import cache
from typing import TYPE_CHECKING, Any

from ident.errors import IdentError

if TYPE_CHECKING:
    from ident.explore.board import Board


def check_panel() -> None:
    """Refuse, before long work, what could not be shown.

    Raises:
        IdentError: if Panel is not installed.
    """
    try:
        import panel  # noqa: F401
    except ImportError:
        raise IdentError("explore needs Panel, which is not installed: pip install panel") from None


@cache
def load_in_jupyter() -> None:
    """Puts Panel's scripts into the notebook, once, so that nothing comes from a network."""
    import panel

    try:
        from IPython.core.getipython import get_ipython
    except ImportError:
        return
    if hasattr(get_ipython(), "kernel"):
        panel.extension(inline=True)


def without_network(board: Board) -> Board:
    """The same, in a notebook: the styles that Panel would fetch there come along with the page."""
    from bokeh.models import ImportedStyleSheet
    from panel.io.resources import CDN_DIST, DIST_DIR

    def inside(viewable: Any, root: Any) -> None:
        for sheet in root.select({"type": ImportedStyleSheet}):
            file = DIST_DIR / sheet.url.removeprefix(CDN_DIST).partition("?")[0]
            if sheet.url.startswith(CDN_DIST) and file.is_file():
                data = base64.b64encode(file.read_bytes()).decode()
                sheet.url = f"data:text/css;base64,{data}"

    layout = board.controls.layout
    layout._preprocessing_hooks = [*layout._preprocessing_hooks, inside]
    return board
