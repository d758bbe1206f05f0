"""Logs in portions, on many machines or sample by sample: sums of the same triangles."""
