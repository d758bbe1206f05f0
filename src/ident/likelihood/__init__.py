"""Former place of `ident.equations.motion_noise`."""
