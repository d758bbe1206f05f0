"""Old names of `ident.information`, until all callers have moved."""
