"""Formats of other programs: ROS 2 bags, and MuJoCo models. `ident.plugins` finds them."""
