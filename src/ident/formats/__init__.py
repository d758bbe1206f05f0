"""Formats of other programs: ROS 2 bags, and MuJoCo models. `ident.files` finds them."""
