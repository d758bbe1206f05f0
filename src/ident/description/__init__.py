"""Files that describe a mechanism: URDF, and MJCF and SDF said again as a URDF with closures."""
