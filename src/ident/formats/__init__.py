"""Formats of other programs: ROS 2 bags, MuJoCo models and SDF. `ident.plugins` finds them."""
