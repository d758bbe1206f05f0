"""Old names of `ident.show.residual`, until all callers have moved."""

from ident.show.residual import plot_maps, plot_own, plot_parts, plot_predictions, short, time_label

__all__ = ["plot_maps", "plot_own", "plot_parts", "plot_predictions", "short", "time_label"]
