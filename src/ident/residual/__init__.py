"""Where a model fails: what it leaves unexplained, and on what that depends."""
