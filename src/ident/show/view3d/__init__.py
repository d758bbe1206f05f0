"""A mechanism moving in 3-D, on Pinocchio's visualizer for viser."""
