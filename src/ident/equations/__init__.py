"""From a mechanism and a motion to the rows of [Γ E | JᵀB]."""
